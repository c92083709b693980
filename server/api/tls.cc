#include "api/tls.h"

#include <grpcpp/security/tls_certificate_provider.h>
#include <grpcpp/security/tls_credentials_options.h>
#include <openssl/err.h>
#include <openssl/ssl.h>

#include "absl/strings/str_cat.h"

namespace soundmap::api {
namespace {

constexpr unsigned kLookEvery_s = 1;

int NoPassword(char*, int, int, void*) { return 0; }

}  // namespace

absl::Status CheckTlsFiles(const TlsFiles& files) {
  if (!files.on()) return absl::OkStatus();
  const std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)> context(SSL_CTX_new(TLS_server_method()),
                                                                  SSL_CTX_free);
  // A key with a password would ask for it on the terminal.
  SSL_CTX_set_default_passwd_cb(context.get(), NoPassword);
  absl::Status status;
  if (SSL_CTX_use_certificate_chain_file(context.get(), files.certificate.c_str()) != 1) {
    status = absl::InvalidArgumentError(
        absl::StrCat(files.certificate, " holds no certificate in PEM form"));
  } else if (X509_cmp_current_time(X509_get0_notAfter(SSL_CTX_get0_certificate(context.get()))) <
             0) {
    status = absl::InvalidArgumentError(
        absl::StrCat("the certificate ", files.certificate, " has expired"));
  } else if (SSL_CTX_use_PrivateKey_file(context.get(), files.key.c_str(), SSL_FILETYPE_PEM) != 1 ||
             SSL_CTX_check_private_key(context.get()) != 1) {
    status = absl::InvalidArgumentError(absl::StrCat(
        files.key, " does not hold the private key of the certificate ", files.certificate));
  } else if (!files.client_ca.empty() &&
             SSL_CTX_load_verify_locations(context.get(), files.client_ca.c_str(), nullptr) != 1) {
    status = absl::InvalidArgumentError(
        absl::StrCat(files.client_ca, " holds no certificate in PEM form"));
  }
  ERR_clear_error();
  return status;
}

std::shared_ptr<grpc::ServerCredentials> GrpcCredentials(const TlsFiles& files) {
  if (!files.on()) return grpc::InsecureServerCredentials();
  using grpc::experimental::FileWatcherCertificateProvider;
  grpc::experimental::TlsServerCredentialsOptions options(
      std::make_shared<FileWatcherCertificateProvider>(files.key, files.certificate,
                                                       files.client_ca, kLookEvery_s));
  options.watch_identity_key_cert_pairs();
  if (!files.client_ca.empty()) {
    options.watch_root_certs();
    options.set_cert_request_type(GRPC_SSL_REQUEST_CLIENT_CERTIFICATE_AND_VERIFY);
  }
  return grpc::experimental::TlsServerCredentials(options);
}

}  // namespace soundmap::api
