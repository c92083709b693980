#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "pipeline/site.h"
#include "soundmap/v1/map_service.pb.h"

namespace soundmap::api {

// One file of an export; a ROS map has two.
struct ExportFile {
  std::string suffix;  // ".ot", ".yaml"
  std::string bytes;
};

struct Export {
  std::vector<ExportFile> files;
  std::int64_t revision = 0;  // of the sound map
  frames::TimeNs as_of_ns = 0;
};

// The files of an ExportMapRequest. InvalidArgument: no such format of this map; NotFound: no such
// band; FailedPrecondition: the site has no geometric map.
absl::StatusOr<Export> ExportMapFiles(pipeline::Site& site, const v1::ExportMapRequest& request);

}  // namespace soundmap::api
