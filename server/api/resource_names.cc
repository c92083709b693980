#include "api/resource_names.h"

#include <initializer_list>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::api {
namespace {

// The parts of `name` that stand between the given collections: {"sites", "sessions"} takes
// "sites/a/sessions/b" apart into a and b.
absl::StatusOr<std::vector<std::string>> Parse(const std::string& name,
                                               std::initializer_list<const char*> collections) {
  const std::vector<std::string> parts = absl::StrSplit(name, '/');
  std::vector<std::string> ids;
  std::string form;
  bool fits = parts.size() == 2 * collections.size();
  std::size_t i = 0;
  for (const char* collection : collections) {
    absl::StrAppend(&form, form.empty() ? "" : "/", collection, "/NAME");
    if (!fits) continue;
    fits = parts[i] == collection && !parts[i + 1].empty();
    ids.push_back(parts[i + 1]);
    i += 2;
  }
  if (!fits) {
    return absl::InvalidArgumentError(
        absl::StrCat("the name '", name, "' is not of the form ", form));
  }
  return ids;
}

absl::StatusOr<std::string> ParseOne(const std::string& name, const char* collection) {
  auto ids = Parse(name, {collection});
  if (!ids.ok()) return ids.status();
  return ids->front();
}

}  // namespace

absl::StatusOr<std::string> ParseSite(const std::string& name) { return ParseOne(name, "sites"); }
absl::StatusOr<std::string> ParseRobot(const std::string& name) { return ParseOne(name, "robots"); }
absl::StatusOr<std::string> ParseOperation(const std::string& name) {
  return ParseOne(name, "operations");
}

absl::StatusOr<SessionName> ParseSession(const std::string& name) {
  const auto ids = Parse(name, {"sites", "sessions"});
  if (!ids.ok()) return ids.status();
  return SessionName{(*ids)[0], (*ids)[1]};
}

absl::StatusOr<SourceName> ParseSoundSource(const std::string& name) {
  const auto ids = Parse(name, {"sites", "soundSources"});
  if (!ids.ok()) return ids.status();
  // What follows the band has no '-'.
  const std::size_t end = (*ids)[1].rfind('-');
  return SourceName{(*ids)[0], end == std::string::npos ? "" : (*ids)[1].substr(0, end), (*ids)[1]};
}

absl::StatusOr<std::vector<std::string>> ParseSessionsOf(const std::string& site,
                                                         const std::vector<std::string>& names) {
  std::vector<std::string> sessions;
  for (const std::string& name : names) {
    auto session = ParseSession(name);
    if (!session.ok()) return session.status();
    if (session->site != site) {
      return absl::InvalidArgumentError(
          absl::StrCat("session '", name, "' is not one of site '", site, "'"));
    }
    sessions.push_back(std::move(session->session));
  }
  return sessions;
}

std::string SiteResource(const std::string& site) { return absl::StrCat("sites/", site); }
std::string RobotResource(const std::string& robot) { return absl::StrCat("robots/", robot); }
std::string OperationResource(const std::string& id) { return absl::StrCat("operations/", id); }
std::string SessionResource(const std::string& site, const std::string& session) {
  return absl::StrCat("sites/", site, "/sessions/", session);
}
std::string SoundSourceResource(const std::string& site, const std::string& source) {
  return absl::StrCat("sites/", site, "/soundSources/", source);
}

}  // namespace soundmap::api
