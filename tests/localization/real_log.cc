#include "real_log.h"

#include <archive.h>
#include <archive_entry.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>

#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

std::string Decompress(const std::string& path) {
  std::unique_ptr<archive, int (*)(archive*)> reader(archive_read_new(), archive_read_free);
  archive_read_support_filter_all(reader.get());
  archive_read_support_format_raw(reader.get());
  archive_entry* entry = nullptr;
  if (archive_read_open_filename(reader.get(), path.c_str(), 1 << 16) != ARCHIVE_OK ||
      archive_read_next_header(reader.get(), &entry) != ARCHIVE_OK) {
    throw std::runtime_error("cannot read " + path);
  }
  std::string text;
  std::vector<char> buffer(1 << 16);
  for (;;) {
    const la_ssize_t count = archive_read_data(reader.get(), buffer.data(), buffer.size());
    if (count < 0) throw std::runtime_error("cannot decompress " + path);
    if (count == 0) return text;
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
}

frames::TimeNs Ns(double time_s) { return std::llround(time_s * 1e6) * 1000; }

}  // namespace

std::string DataFolder() {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  const std::filesystem::path path =
      folder != nullptr ? std::filesystem::path(folder)
                        : std::filesystem::path(SOUNDMAP_SOURCE_DIR) / ".." / "shared" / "data";
  return std::filesystem::exists(path) ? path.string() : "";
}

RealLog ReadCarmenLog(const std::string& log_path, const std::string& poses_path,
                      double no_return_m) {
  RealLog log;
  std::istringstream text(Decompress(log_path));
  std::string line;
  std::vector<frames::Frame> scan_odometry;
  bool has_odometry = false;
  while (std::getline(text, line)) {
    std::istringstream words(line);
    std::string kind;
    words >> kind;
    double time_s = 0.0;
    std::string host;
    if (kind == "ODOM") {
      frames::Odometry odometry;
      double tv, rv, acceleration;
      words >> odometry.odom_from_base.x_m >> odometry.odom_from_base.y_m >>
          odometry.odom_from_base.yaw_rad >> tv >> rv >> acceleration >> time_s;
      odometry.stamp_ns = Ns(time_s);
      log.frames.emplace_back(odometry);
      has_odometry = true;
    } else if (kind == "FLASER") {
      int count = 0;
      words >> count;
      frames::LaserScan scan;
      for (int i = 0; i < count; ++i) {
        double range_m;
        words >> range_m;
        scan.range_m.push_back(range_m < no_return_m ? static_cast<float>(range_m)
                                                     : std::numeric_limits<float>::quiet_NaN());
      }
      // 180 degrees: 360 beams leave out the last one.
      scan.start_angle_rad = -geometry::kPi / 2.0;
      scan.angle_increment_rad = geometry::kPi / (count % 2 == 1 ? count - 1 : count);
      Pose2 laser;
      frames::Odometry odometry;
      words >> laser.x_m >> laser.y_m >> laser.yaw_rad >> odometry.odom_from_base.x_m >>
          odometry.odom_from_base.y_m >> odometry.odom_from_base.yaw_rad >> time_s;
      scan.stamp_ns = odometry.stamp_ns = Ns(time_s);
      scan_odometry.emplace_back(odometry);
      scan_odometry.emplace_back(scan);
      log.frames.emplace_back(std::move(scan));
    }
  }
  if (!has_odometry) log.frames = std::move(scan_odometry);
  std::ifstream poses(poses_path);
  while (std::getline(poses, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    double time_s;
    Pose2 pose;
    if (words >> time_s >> pose.x_m >> pose.y_m >> pose.yaw_rad) {
      log.true_poses.push_back({Ns(time_s), pose});
    }
  }
  return log;
}

building::FloorPlan DrawPlan(const RealLog& log, double cell_size_m, double max_range_m) {
  std::map<frames::TimeNs, const frames::LaserScan*> scans;
  for (const frames::Frame& frame : log.frames) {
    if (const auto* scan = std::get_if<frames::LaserScan>(&frame)) scans[scan->stamp_ns] = scan;
  }
  Eigen::AlignedBox2d box;
  for (const StampedPose& pose : log.true_poses) {
    box.extend(Eigen::Vector2d(pose.map_from_base.x_m, pose.map_from_base.y_m));
  }
  const Eigen::Vector2d origin = box.min() - Eigen::Vector2d::Constant(max_range_m + 1.0);
  const Eigen::Vector2d size = box.sizes() + Eigen::Vector2d::Constant(2.0 * max_range_m + 2.0);
  building::FloorPlan plan(static_cast<int>(size.x() / cell_size_m),
                           static_cast<int>(size.y() / cell_size_m), cell_size_m, origin);
  const auto index = [&](const Eigen::Vector2d& point) {
    return static_cast<std::size_t>((point.y() - origin.y()) / cell_size_m) * plan.width() +
           static_cast<std::size_t>((point.x() - origin.x()) / cell_size_m);
  };
  std::vector<int> ended(plan.cells().size(), 0);
  std::vector<int> passed(plan.cells().size(), 0);
  std::vector<std::size_t> last_passer(plan.cells().size(), 0);
  std::size_t beam = 0;
  for (const StampedPose& pose : log.true_poses) {
    const auto found = scans.find(pose.stamp_ns);
    if (found == scans.end()) continue;
    const frames::LaserScan& scan = *found->second;
    const Eigen::Vector2d from(pose.map_from_base.x_m, pose.map_from_base.y_m);
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
      ++beam;
      if (!std::isfinite(scan.range_m[i])) continue;
      const double angle_rad = pose.map_from_base.yaw_rad + scan.start_angle_rad +
                               static_cast<double>(i) * scan.angle_increment_rad;
      const Eigen::Vector2d direction(std::cos(angle_rad), std::sin(angle_rad));
      const bool ends = scan.range_m[i] < max_range_m;
      const double range_m = ends ? scan.range_m[i] : max_range_m;
      const std::size_t end = index(from + range_m * direction);
      for (double along_m = 0.0; along_m < range_m; along_m += 0.5 * cell_size_m) {
        const std::size_t cell = index(from + along_m * direction);
        if (last_passer[cell] == beam || (ends && cell == end)) continue;
        last_passer[cell] = beam;
        ++passed[cell];
      }
      if (ends) ++ended[end];
    }
  }
  for (int row = 0; row < plan.height(); ++row) {
    for (int column = 0; column < plan.width(); ++column) {
      const std::size_t cell = static_cast<std::size_t>(row) * plan.width() + column;
      // As an octree weighs them: log-odds of 0.7 for an end, of 0.4 for a passage.
      if (0.85 * ended[cell] > 0.4 * passed[cell]) {
        plan.at(column, row) = building::Cell::kOccupied;
      } else if (passed[cell] > 0) {
        plan.at(column, row) = building::Cell::kFree;
      }
    }
  }
  return plan;
}

void Transform(const Pose2& map_from_log, std::vector<StampedPose>& poses) {
  for (StampedPose& pose : poses) pose.map_from_base = map_from_log * pose.map_from_base;
}

std::size_t FirstAt(const RealLog& log, frames::TimeNs time_ns) {
  std::size_t i = 0;
  while (i < log.frames.size() && frames::StampOf(log.frames[i]) < time_ns) ++i;
  return i;
}

}  // namespace soundmap::localization
