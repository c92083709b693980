#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace soundmap::api {

// Names of the API's resources and what stands in them. The parsers return InvalidArgument with the
// name as it came; whether the parts are names that can exist is for those who look them up.
struct SessionName {
  std::string site;
  std::string session;
};
struct SourceName {
  std::string site;
  std::string band;  // that {source} begins with; empty: none
  std::string source;
};

absl::StatusOr<std::string> ParseSite(const std::string& name);       // "sites/{site}"
absl::StatusOr<std::string> ParseRobot(const std::string& name);      // "robots/{robot}"
absl::StatusOr<std::string> ParseOperation(const std::string& name);  // "operations/{id}"
absl::StatusOr<SessionName> ParseSession(
    const std::string& name);  // "sites/{site}/sessions/{session}"
absl::StatusOr<SourceName> ParseSoundSource(
    const std::string& name);  // "sites/{site}/soundSources/{source}"

// The {session} of each; all must be of the site.
absl::StatusOr<std::vector<std::string>> ParseSessionsOf(const std::string& site,
                                                         const std::vector<std::string>& names);

std::string SiteResource(const std::string& site);
std::string RobotResource(const std::string& robot);
std::string OperationResource(const std::string& id);
std::string SessionResource(const std::string& site, const std::string& session);
std::string SoundSourceResource(const std::string& site, const std::string& source);

}  // namespace soundmap::api
