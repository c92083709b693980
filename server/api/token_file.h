#pragma once

#include <set>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "api/grant.h"

namespace soundmap::api {

// SHA-256, 32 bytes.
std::string Sha256(const std::string& bytes);

// Who may do what, as TOML (docs/security.md). The file holds the tokens' hashes only:
//
//   refused_robots = ["r7"]          # whose certificates are believed no more
//   [[token]]
//   name = "dashboard"
//   sha256 = "<64 hexadecimal digits>"
//   role = "read"                    # read, robot, write, admin
//   robot = "r1"                     # with the role "robot"
//   sites = ["plant", "hall"]        # or ["*"]
//   expires = 2027-01-01T00:00:00Z   # optional
class TokenFile {
 public:
  // `path` stands in sentences. InvalidArgument, naming the token at fault.
  static absl::StatusOr<TokenFile> Parse(const std::string& text, const std::string& path);

  // Null if no token has this hash. Takes as long for any hash.
  const Grant* Find(const std::string& sha256) const;
  bool Refuses(const std::string& robot) const { return refused_robots_.count(robot) != 0; }

 private:
  struct Entry {
    std::string sha256;
    Grant grant;
  };
  std::vector<Entry> entries_;
  std::set<std::string> refused_robots_;
};

}  // namespace soundmap::api
