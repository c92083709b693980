#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace soundmap::api {

// What somebody may do at a site; each right includes those before it.
enum class Right {
  kRead,
  kStream,  // send drives, as the robot that the grant names
  kWrite,   // send drives as any robot, make and import geometric maps
  kAdmin,   // create and delete sites, back up
};

// What a credential stands for.
struct Grant {
  std::string who;  // for sentences and the audit log: "token dashboard", "robot r1"
  Right right = Right::kRead;
  std::string robot;  // with Right::kStream: whose drives
  bool all_sites = false;
  std::vector<std::string> sites;
  std::int64_t expires_ns = std::numeric_limits<std::int64_t>::max();

  bool Reaches(const std::string& site) const;

  // PermissionDenied, also where there is no such site. An empty site is the server as a whole;
  // `robot` counts for Right::kStream.
  absl::Status Check(Right needed, const std::string& site, const std::string& robot = {}) const;
};

// What the URIs among a robot's certificate's subject alternative names say:
// soundmap://robots/ROBOT once, soundmap://sites/SITE for each of its sites or soundmap://sites/*
// for all. Unauthenticated: they name no robot, or something is not a name.
absl::StatusOr<Grant> GrantFromCertificate(const std::vector<std::string>& uris);

}  // namespace soundmap::api
