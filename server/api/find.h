#pragma once

#include <memory>
#include <string>

#include "api/resource_names.h"
#include "pipeline/sites.h"

namespace soundmap::api {

// What a resource name means. InvalidArgument: not such a name; NotFound.
inline absl::StatusOr<std::shared_ptr<pipeline::Site>> FindSite(const pipeline::Sites& sites,
                                                                const std::string& name) {
  const auto site = ParseSite(name);
  if (!site.ok()) return site.status();
  return sites.Get(*site);
}

inline absl::StatusOr<std::shared_ptr<pipeline::Session>> FindSession(const pipeline::Sites& sites,
                                                                      const std::string& name) {
  const auto session = ParseSession(name);
  if (!session.ok()) return session.status();
  const auto site = sites.Get(session->site);
  if (!site.ok()) return site.status();
  return (*site)->GetSession(session->session);
}

}  // namespace soundmap::api
