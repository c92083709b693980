#pragma once

#include <memory>
#include <string>

#include "api/access.h"
#include "api/resource_names.h"
#include "pipeline/sites.h"

namespace soundmap::api {

// What a resource name means, for who asks. Unauthenticated; PermissionDenied, whether it is there
// or not; InvalidArgument: not such a name; NotFound.
inline absl::StatusOr<std::shared_ptr<pipeline::Site>> FindSite(const pipeline::Sites& sites,
                                                                const std::string& name,
                                                                Right right, Access& access,
                                                                const Caller& caller) {
  const auto site = ParseSite(name);
  if (!site.ok()) return site.status();
  const absl::Status allowed = access.Check(caller, right, *site);
  if (!allowed.ok()) return allowed;
  return sites.Get(*site);
}
inline absl::StatusOr<std::shared_ptr<pipeline::Site>> FindSite(const pipeline::Sites& sites,
                                                                const std::string& name,
                                                                const Ask& ask) {
  const auto caller = ask.access->CallerOf(*ask.context);
  if (!caller.ok()) return caller.status();
  return FindSite(sites, name, ask.right, *ask.access, *caller);
}

inline absl::StatusOr<std::shared_ptr<pipeline::Session>> FindSession(const pipeline::Sites& sites,
                                                                      const std::string& name,
                                                                      Right right, Access& access,
                                                                      const Caller& caller) {
  const auto session = ParseSession(name);
  if (!session.ok()) return session.status();
  const absl::Status allowed = access.Check(caller, right, session->site);
  if (!allowed.ok()) return allowed;
  const auto site = sites.Get(session->site);
  if (!site.ok()) return site.status();
  return (*site)->GetSession(session->session);
}
inline absl::StatusOr<std::shared_ptr<pipeline::Session>> FindSession(const pipeline::Sites& sites,
                                                                      const std::string& name,
                                                                      const Ask& ask) {
  const auto caller = ask.access->CallerOf(*ask.context);
  if (!caller.ok()) return caller.status();
  return FindSession(sites, name, ask.right, *ask.access, *caller);
}

}  // namespace soundmap::api
