#include "api/map_files.h"

#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <optional>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "building/files.h"
#include "foxglove/PointCloud.pb.h"
#include "recording/writer.h"
#include "sound_map/export.h"
#include "sound_map/plan_view.h"

namespace soundmap::api {
namespace {

namespace fs = std::filesystem;

absl::Status NoSuchFormat(const char* what, const std::string& format) {
  return absl::InvalidArgumentError(
      absl::StrCat("the ", what, " is not exported as '", format, "'"));
}

std::optional<sound_map::PlanImage> PlanOf(const pipeline::Site& site) {
  const auto building = site.building();
  if (!building) return std::nullopt;
  const building::FloorPlan& plan = building->floor_plan;
  sound_map::PlanImage image;
  image.width = plan.width();
  image.height = plan.height();
  image.cell_size_m = plan.cell_size_m();
  image.origin_in_map_m = plan.origin_in_map_m();
  image.cells.reserve(plan.cells().size());
  for (const building::Cell cell : plan.cells()) {
    image.cells.push_back(static_cast<std::uint8_t>(cell));
  }
  return image;
}

// The voxels as one foxglove.PointCloud: x, y, z, log_odds (float32), update_count (uint32), age_s
// (float32, before the newest).
foxglove::PointCloud CloudFrom(const sound_map::Snapshot& map, std::uint32_t min_updates) {
  struct Point {
    float x, y, z, log_odds;
    std::uint32_t update_count;
    float age_s;
  };
  const frames::TimeNs as_of_ns = map.as_of_ns().value_or(0);
  foxglove::PointCloud cloud;
  cloud.mutable_timestamp()->set_seconds(as_of_ns / 1'000'000'000);
  cloud.mutable_timestamp()->set_nanos(static_cast<int>(as_of_ns % 1'000'000'000));
  cloud.set_frame_id("map");
  cloud.mutable_pose()->mutable_orientation()->set_w(1.0);
  cloud.mutable_pose()->mutable_position();
  cloud.set_point_stride(sizeof(Point));
  const struct {
    const char* name;
    std::size_t offset;
    foxglove::PackedElementField::NumericType type;
  } fields[] = {
      {"x", offsetof(Point, x), foxglove::PackedElementField::FLOAT32},
      {"y", offsetof(Point, y), foxglove::PackedElementField::FLOAT32},
      {"z", offsetof(Point, z), foxglove::PackedElementField::FLOAT32},
      {"log_odds", offsetof(Point, log_odds), foxglove::PackedElementField::FLOAT32},
      {"update_count", offsetof(Point, update_count), foxglove::PackedElementField::UINT32},
      {"age_s", offsetof(Point, age_s), foxglove::PackedElementField::FLOAT32}};
  for (const auto& field : fields) {
    foxglove::PackedElementField* proto = cloud.add_fields();
    proto->set_name(field.name);
    proto->set_offset(static_cast<std::uint32_t>(field.offset));
    proto->set_type(field.type);
  }
  map.ForEach([&](const geometry::VoxelKey& key, const sound_map::Voxel& voxel) {
    if (voxel.update_count <= min_updates) return true;
    const Eigen::Vector3f p = geometry::PointFromKey(key, map.voxel_size_m()).cast<float>();
    const Point point{p.x(),
                      p.y(),
                      p.z(),
                      voxel.log_odds,
                      voxel.update_count,
                      static_cast<float>(frames::SecondsFromNs(as_of_ns - voxel.last_update_ns))};
    cloud.mutable_data()->append(reinterpret_cast<const char*>(&point), sizeof(point));
    return true;
  });
  return cloud;
}

// The recording library writes files; this one lives for as long as it takes to read it back.
absl::StatusOr<std::string> McapFrom(const foxglove::PointCloud& cloud, frames::TimeNs time_ns) {
  std::string folder = (fs::temp_directory_path() / "soundmap-export-XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) {
    return absl::InternalError(
        absl::StrCat("cannot make a temporary folder ", folder, ": ", std::strerror(errno)));
  }
  const std::string path = folder + "/map.mcap";
  absl::Status status;
  {
    auto writer = recording::Writer::Create(path, {});
    status = writer.status();
    if (status.ok()) {
      status = (*writer)->Write("/sound_map", "foxglove.PointCloud", time_ns, 0,
                                cloud.SerializeAsString());
    }
    if (status.ok()) status = (*writer)->Close();
  }
  std::ostringstream bytes;
  if (status.ok()) bytes << std::ifstream(path, std::ios::binary).rdbuf();
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  if (!status.ok()) return status;
  return std::move(bytes).str();
}

absl::StatusOr<std::string> ExportSound(pipeline::Site& site, std::uint8_t band,
                                        const sound_map::Snapshot& map,
                                        const v1::ExportMapRequest& request) {
  if (request.min_updates() < 0 ||
      request.min_updates() > std::numeric_limits<std::uint32_t>::max()) {
    return absl::InvalidArgumentError("min_updates is out of range");
  }
  const auto min_updates = static_cast<std::uint32_t>(request.min_updates());
  const std::string& format = request.format();
  if (format == "png") {
    sound_map::PlanViewOptions options;
    options.title = absl::StrCat("Sound map of ", site.record().site);
    if (band != pipeline::kMainBand) {
      absl::StrAppend(&options.title, ", band ", site.BandName(band));
    }
    options.min_updates = min_updates;
    std::vector<sound_map::SoundSource> sources;
    for (const sound_map::RegisteredSource& source : site.region().sources(band)->sources) {
      if (source.state != sound_map::SourceState::kGone) sources.push_back(source.found);
    }
    return sound_map::RenderPlanView(map, PlanOf(site), sources, options);
  }
  if (format == "mcap") return McapFrom(CloudFrom(map, min_updates), map.as_of_ns().value_or(0));
  std::ostringstream stream(std::ios::binary);
  absl::Status written;
  if (format == "ot" && request.full()) {
    written = sound_map::WriteSoundOcTree(map, min_updates, stream);
  } else if (format == "ot") {
    written = sound_map::WriteOcTree(map, min_updates, stream);
  } else if (format == "bt") {
    written = sound_map::WriteOccupancy(map, min_updates, stream);
  } else if (format == "ply") {
    written = sound_map::WritePly(map, min_updates, stream);
  } else if (format == "pcd") {
    written = sound_map::WritePcd(map, min_updates, stream);
  } else {
    return NoSuchFormat("sound map", format);
  }
  if (!written.ok()) return written;
  return std::move(stream).str();
}

absl::StatusOr<std::string> ExportGeometry(const building::Building& building,
                                           const std::string& format) {
  const auto known = building::MapFormatOfPath(absl::StrCat("map.", format));
  if (!known || *known == building::MapFormat::kRosYaml) {
    return NoSuchFormat("geometric map", format);
  }
  return building::ExportGeometry(building, *known);
}

}  // namespace

absl::StatusOr<Export> ExportMapFiles(pipeline::Site& site, const v1::ExportMapRequest& request) {
  const std::string site_name = site.record().site;
  const auto band = site.FindBand(request.band());
  if (!band.ok()) return band.status();
  if (*band != pipeline::kMainBand && request.what() != v1::EXPORT_WHAT_SOUND) {
    return absl::InvalidArgumentError("only the sound map has bands");
  }
  const auto map = site.region().snapshot(*band);
  Export result;
  result.revision = static_cast<std::int64_t>(map->revision());
  result.as_of_ns = map->as_of_ns().value_or(0);
  const std::string suffix = absl::StrCat(".", request.format());
  if (request.what() == v1::EXPORT_WHAT_SOUND) {
    auto bytes = ExportSound(site, *band, *map, request);
    if (!bytes.ok()) return bytes.status();
    result.files.push_back({suffix, *std::move(bytes)});
    return result;
  }
  const auto building = site.building();
  if (!building) {
    return absl::FailedPreconditionError(
        absl::StrCat("site '", site_name, "' has no geometric map"));
  }
  if (request.what() == v1::EXPORT_WHAT_GEOMETRY) {
    auto bytes = ExportGeometry(*building, request.format());
    if (!bytes.ok()) return bytes.status();
    result.files.push_back({suffix, *std::move(bytes)});
  } else if (request.what() == v1::EXPORT_WHAT_FLOOR_PLAN && request.format() == "yaml") {
    building::RosMap files = building::ToRosMap(building->floor_plan, site_name + ".pgm");
    result.files.push_back({".yaml", std::move(files.yaml)});
    result.files.push_back({".pgm", std::move(files.pgm)});
  } else if (request.what() == v1::EXPORT_WHAT_FLOOR_PLAN && request.format() == "png") {
    const sound_map::Snapshot nothing(map->voxel_size_m(), 0, std::nullopt, {});
    sound_map::PlanViewOptions options;
    options.title = absl::StrCat("Floor plan of ", site_name);
    options.floor_plan_only = true;
    auto bytes = sound_map::RenderPlanView(nothing, PlanOf(site), {}, options);
    if (!bytes.ok()) return bytes.status();
    result.files.push_back({suffix, *std::move(bytes)});
  } else if (request.what() == v1::EXPORT_WHAT_FLOOR_PLAN) {
    return NoSuchFormat("floor plan", request.format());
  } else {
    return absl::InvalidArgumentError("what to export is not given");
  }
  return result;
}

}  // namespace soundmap::api
