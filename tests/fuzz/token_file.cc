#include "api/token_file.h"

#include "tests/fuzz/target.h"

namespace soundmap::fuzz {

std::vector<std::string> Seeds() {
  return {"refused_robots = [\"r7\"]\n[[token]]\nname = \"a\"\nsha256 = \"" + std::string(64, 'a') +
              "\"\nrole = \"robot\"\nrobot = \"r1\"\nsites = [\"x\", \"*\"]\nexpires = "
              "2027-01-01T00:00:00Z\n",
          "soundmap://robots/r1\nsoundmap://sites/a\nsoundmap://sites/*\n"};
}

// As a token file, and as the URIs of a certificate, one a line.
void Decode(std::string_view bytes) {
  const auto file = api::TokenFile::Parse(std::string(bytes), "tokens");
  if (file.ok()) Require(file->Find(std::string(31, 'a')) == nullptr);
  std::vector<std::string> uris(1);
  for (const char c : bytes) {
    if (c == '\n') {
      uris.emplace_back();
    } else {
      uris.back() += c;
    }
  }
  const auto grant = api::GrantFromCertificate(uris);
  if (!grant.ok()) return;
  Require(!grant->robot.empty() && grant->right == api::Right::kStream);
  Require(grant->Check(api::Right::kWrite, "a", grant->robot).code() ==
          absl::StatusCode::kPermissionDenied);
}

}  // namespace soundmap::fuzz
