#include "api/grant.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "storage/names.h"

namespace soundmap::api {
namespace {

const char* Deed(Right right) {
  switch (right) {
    case Right::kRead:
      return "read";
    case Right::kStream:
      return "send drives";
    case Right::kWrite:
      return "write";
    case Right::kAdmin:
      return "administrate";
  }
  return "do anything";
}

}  // namespace

bool Grant::Reaches(const std::string& site) const {
  return all_sites || std::find(sites.begin(), sites.end(), site) != sites.end();
}

absl::Status Grant::Check(Right needed, const std::string& site, const std::string& as) const {
  const bool may = right >= needed && Reaches(site);
  if (may && (needed != Right::kStream || right > Right::kStream || as == robot)) {
    return absl::OkStatus();
  }
  std::string deed = Deed(needed);
  if (may) absl::StrAppend(&deed, " as robot '", as, "'");
  return absl::PermissionDeniedError(
      site.empty() ? absl::StrCat(who, " may not ", deed, " where all sites are concerned")
                   : absl::StrCat(who, " may not ", deed, " at site '", site, "'"));
}

absl::StatusOr<Grant> GrantFromCertificate(const std::vector<std::string>& uris) {
  Grant grant;
  grant.right = Right::kStream;
  for (const std::string& uri : uris) {
    absl::string_view rest = uri;
    absl::Status valid;
    if (absl::ConsumePrefix(&rest, "soundmap://robots/")) {
      if (!grant.robot.empty()) {
        return absl::UnauthenticatedError("the certificate names several robots");
      }
      grant.robot = std::string(rest);
      valid = storage::ValidateName("robot", grant.robot);
    } else if (absl::ConsumePrefix(&rest, "soundmap://sites/")) {
      if (rest == "*") {
        grant.all_sites = true;
      } else {
        grant.sites.emplace_back(rest);
        valid = storage::ValidateName("site", grant.sites.back());
      }
    }
    if (!valid.ok()) {
      return absl::UnauthenticatedError(
          absl::StrCat("of the certificate, ", std::string(valid.message())));
    }
  }
  if (grant.robot.empty()) {
    return absl::UnauthenticatedError("the certificate names no robot (soundmap://robots/ROBOT)");
  }
  grant.who = absl::StrCat("robot ", grant.robot);
  return grant;
}

}  // namespace soundmap::api
