#include "server_files.h"

#include <fstream>
#include <iterator>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"

namespace soundmap {
namespace {

absl::StatusOr<std::string> FileText(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (!file) return absl::NotFoundError(absl::StrCat("cannot read '", path, "'"));
  return text;
}

}  // namespace

absl::StatusOr<uplink::ServerOptions> ReadServerOptions(const ServerFiles& files) {
  uplink::ServerOptions server;
  server.address = files.address;
  for (const auto& [path, text] :
       {std::pair(&files.token_file, &server.token), std::pair(&files.tls_ca, &server.tls_ca_pem),
        std::pair(&files.tls_cert, &server.tls_cert_pem),
        std::pair(&files.tls_key, &server.tls_key_pem)}) {
    if (path->empty()) continue;
    absl::StatusOr<std::string> read = FileText(*path);
    if (!read.ok()) return read.status();
    *text = *std::move(read);
  }
  server.token = std::string(absl::StripAsciiWhitespace(server.token));
  return server;
}

}  // namespace soundmap
