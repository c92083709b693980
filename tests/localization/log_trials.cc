#include "log_trials.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <numeric>
#include <random>
#include <sstream>

#include "building/files.h"
#include "geometry/angles.h"

namespace soundmap::localization {
namespace {

using frames::TimeNs;
using geometry::Pose2;

constexpr double kCellSize_m = 0.05;
constexpr double kDrawnRange_m = 15.0;

double Between(const Pose2& a, const Pose2& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

double Turn(const Pose2& a, const Pose2& b) {
  return std::abs(geometry::NormalizeAngle(a.yaw_rad - b.yaw_rad));
}

std::vector<PoseEstimate> Feed(Localizer& localizer, const frames::Frame& frame) {
  if (const auto* odometry = std::get_if<frames::Odometry>(&frame)) {
    return localizer.Add(*odometry);
  }
  return localizer.Add(std::get<frames::LaserScan>(frame));
}

Pose2 LaserInBase(const Scene& scene) { return {scene.laser_x_m, 0.0, 0.0}; }

// The path's pose at a time, between two by interpolation.
std::optional<Pose2> PoseAt(const std::vector<StampedPose>& path, TimeNs time_ns) {
  const auto after = std::lower_bound(
      path.begin(), path.end(), time_ns,
      [](const StampedPose& pose, TimeNs wanted_ns) { return pose.stamp_ns < wanted_ns; });
  if (after == path.end() || (after == path.begin() && after->stamp_ns != time_ns)) {
    return std::nullopt;
  }
  if (after->stamp_ns == time_ns) return after->map_from_base;
  const auto before = std::prev(after);
  return geometry::Interpolate(before->map_from_base, after->map_from_base,
                               static_cast<double>(time_ns - before->stamp_ns) /
                                   static_cast<double>(after->stamp_ns - before->stamp_ns));
}

// Frames from the first true pose on, and a Localizer that starts there.
Localizer StartAtFirstPose(const Scene& scene, const std::shared_ptr<const PreparedPlan>& plan,
                           std::uint64_t seed) {
  const Pose2 start = scene.log.true_poses.front().map_from_base * LaserInBase(scene).Inverse();
  return Localizer::Create(plan, scene.calibration(), InitialPose{start}, seed).value();
}

}  // namespace

Config Scene::config() const {
  Config config;
  if (is_lag_given) config.laser_lag_s = lag_s;
  return config;
}

frames::Calibration Scene::calibration() const {
  frames::Calibration calibration;
  calibration.base_from_laser.translation() << laser_x_m, 0.0, 0.3;
  return calibration;
}

Scene AcesScene() {
  const std::string folder = DataFolder() + "/aces";
  Scene scene{"aces",
              ReadCarmenLog(folder + "/aces.clf.bz2", folder + "/corrected_poses.csv", 49.0),
              {},
              0.0,
              0.085};
  scene.plan = DrawPlan(scene.log, kCellSize_m, kDrawnRange_m);
  return scene;
}

Scene CsailScene() {
  const std::string folder = DataFolder() + "/mit_csail";
  Scene scene{"csail",
              ReadCarmenLog(folder + "/mit-csail.clf.bz2", folder + "/corrected_poses.csv", 80.0),
              {},
              0.0,
              0.12};
  scene.plan = DrawPlan(scene.log, kCellSize_m, kDrawnRange_m);
  return scene;
}

Scene Building079Scene() {
  const std::string folder = DataFolder() + "/building_079";
  Scene scene{
      "fr079 on geb079",
      ReadCarmenLog(folder + "/fr079_first_150s.clf.bz2", folder + "/corrected_poses.csv", 80.0),
      {},
      -0.04,
      0.12};
  scene.plan = building::ImportBuilding(folder + "/geb079.bt", {})->floor_plan;
  Transform({17.84, 0.31, geometry::RadFromDeg(4.89)}, scene.log.true_poses);
  const TimeNs end_ns = frames::StampOf(scene.log.frames.back());
  std::erase_if(scene.log.true_poses,
                [&](const StampedPose& pose) { return pose.stamp_ns > end_ns; });
  return scene;
}

TrackResult Track(const Scene& scene, const std::shared_ptr<const PreparedPlan>& plan,
                  std::uint64_t seed) {
  Localizer localizer = StartAtFirstPose(scene, plan, seed);
  const TimeNs lag_ns = frames::NsFromSeconds(scene.lag_s);
  TrackResult result;
  std::vector<double> errors_m;
  double fit_sum = 0.0;
  double busy_us = 0.0;
  int corrections = 0;
  auto next = scene.log.true_poses.begin();
  for (std::size_t i = FirstAt(scene.log, next->stamp_ns - lag_ns); i < scene.log.frames.size();
       ++i) {
    const auto begin = std::chrono::steady_clock::now();
    for (const PoseEstimate& estimate : Feed(localizer, scene.log.frames[i])) {
      fit_sum += estimate.scan_fit;
      ++corrections;
      busy_us += std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin)
                     .count();
    }
    const TimeNs now_ns = frames::StampOf(scene.log.frames[i]);
    for (; next != scene.log.true_poses.end() && next->stamp_ns + 1'000'000'000 < now_ns; ++next) {
      const auto estimate = localizer.At(next->stamp_ns - lag_ns);
      if (!estimate) continue;
      const Pose2 laser = estimate->map_from_base * LaserInBase(scene);
      errors_m.push_back(Between(laser, next->map_from_base));
      result.mean_yaw_rad += Turn(laser, next->map_from_base);
      result.tracking_share += estimate->state == State::kTracking;
      result.lost_share += estimate->state == State::kLost;
    }
  }
  result.poses = static_cast<int>(errors_m.size());
  const double count = std::max(1, result.poses);
  result.mean_m = std::accumulate(errors_m.begin(), errors_m.end(), 0.0) / count;
  result.mean_yaw_rad /= count;
  result.tracking_share /= count;
  result.lost_share /= count;
  result.mean_fit = fit_sum / std::max(1, corrections);
  result.correction_us = busy_us / std::max(1, corrections);
  std::sort(errors_m.begin(), errors_m.end());
  if (!errors_m.empty()) {
    result.p95_m = errors_m[errors_m.size() * 95 / 100];
    result.max_m = errors_m.back();
  }
  result.laser_lag_s = localizer.laser_lag_s();
  result.counters = localizer.counters();
  return result;
}

std::vector<StampedPose> TrackedPath(const Scene& scene,
                                     const std::shared_ptr<const PreparedPlan>& plan,
                                     std::uint64_t seed) {
  Localizer localizer = StartAtFirstPose(scene, plan, seed);
  const TimeNs lag_ns = frames::NsFromSeconds(scene.lag_s);
  std::vector<StampedPose> path;
  std::deque<TimeNs> wanted;
  for (std::size_t i = FirstAt(scene.log, scene.log.true_poses.front().stamp_ns - lag_ns);
       i < scene.log.frames.size(); ++i) {
    const frames::Frame& frame = scene.log.frames[i];
    Feed(localizer, frame);
    if (std::holds_alternative<frames::LaserScan>(frame)) wanted.push_back(frames::StampOf(frame));
    while (!wanted.empty() && (wanted.front() + 1'000'000'000 < frames::StampOf(frame) ||
                               i + 1 == scene.log.frames.size())) {
      if (const auto estimate = localizer.At(wanted.front() - lag_ns)) {
        path.push_back({wanted.front(), estimate->map_from_base * LaserInBase(scene)});
      }
      wanted.pop_front();
    }
  }
  return path;
}

RelationsResult Relations(const std::string& relations_path, const std::vector<StampedPose>& path) {
  RelationsResult result;
  std::ifstream file(relations_path);
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    double begin_s, end_s, z_m, roll_rad, pitch_rad;
    Pose2 begin_from_end;
    if (!(words >> begin_s >> end_s >> begin_from_end.x_m >> begin_from_end.y_m >> z_m >>
          roll_rad >> pitch_rad >> begin_from_end.yaw_rad)) {
      continue;
    }
    const auto begin = PoseAt(path, std::llround(begin_s * 1e6) * 1000);
    const auto end = PoseAt(path, std::llround(end_s * 1e6) * 1000);
    if (!begin || !end) continue;
    const Pose2 error = begin_from_end.Inverse() * (begin->Inverse() * *end);
    result.mean_m += std::hypot(error.x_m, error.y_m);
    result.mean_rad += std::abs(error.yaw_rad);
    ++result.relations;
  }
  result.mean_m /= std::max(1, result.relations);
  result.mean_rad /= std::max(1, result.relations);
  return result;
}

std::vector<std::size_t> TrialStarts(const Scene& scene, const std::vector<StampedPose>& path,
                                     int count, double drive_m, std::uint64_t seed) {
  std::vector<double> driven_m = {0.0};
  for (std::size_t i = 1; i < path.size(); ++i) {
    driven_m.push_back(driven_m.back() + Between(path[i - 1].map_from_base, path[i].map_from_base));
  }
  std::mt19937_64 engine(seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::vector<std::size_t> starts;
  for (int i = 0; i < count; ++i) {
    // One in each part of the way.
    const double at_m = (i + uniform(engine)) / count * (driven_m.back() - drive_m);
    const auto pose = std::lower_bound(driven_m.begin(), driven_m.end(), at_m) - driven_m.begin();
    starts.push_back(FirstAt(scene.log, path[pose].stamp_ns));
  }
  return starts;
}

TrialResult RunTrial(const Scene& scene, const std::shared_ptr<const PreparedPlan>& plan,
                     const std::vector<StampedPose>& path, std::size_t from, std::size_t to,
                     double before_m, double drive_m, std::uint64_t seed) {
  const TimeNs lag_ns = frames::NsFromSeconds(scene.lag_s);
  const std::vector<frames::Frame>& frames = scene.log.frames;
  const auto truth_at = [&](TimeNs log_ns) { return PoseAt(path, log_ns); };
  std::size_t first = to;
  std::optional<InitialPose> start;
  if (from != to) {
    double driven_m = 0.0;
    auto pose = std::lower_bound(path.begin(), path.end(), frames::StampOf(frames[from]),
                                 [](const StampedPose& p, TimeNs t) { return p.stamp_ns < t; });
    while (pose != path.begin() && driven_m < before_m) {
      driven_m += Between(std::prev(pose)->map_from_base, pose->map_from_base);
      --pose;
    }
    first = FirstAt(scene.log, pose->stamp_ns);
    start = InitialPose{pose->map_from_base * LaserInBase(scene).Inverse()};
  }
  Localizer localizer = Localizer::Create(plan, scene.calibration(), start, seed).value();
  localizer.KeepFrom(std::numeric_limits<TimeNs>::min());

  TrialResult result;
  std::map<TimeNs, Pose2> truth;  // by stamps as sent, of corrections
  std::optional<Pose2> last_truth;
  std::optional<Pose2> newest_sent, newest_raw;
  TimeNs shift_ns = 0;
  double driven_m = 0.0;
  bool carried = from == to;
  bool done = false;
  std::vector<std::size_t> order;
  for (std::size_t i = first; from != to && i < from; ++i) order.push_back(i);
  const std::size_t before_count = order.size();
  for (std::size_t i = to; i < frames.size(); ++i) order.push_back(i);
  for (std::size_t k = 0; k < order.size() && !done; ++k) {
    frames::Frame frame = frames[order[k]];
    if (k == before_count && from != to) {
      shift_ns = frames::StampOf(frames[order[k - 1]]) + 100'000'000 - frames::StampOf(frame);
      carried = true;
      last_truth.reset();
      newest_raw.reset();
    }
    if (auto* odometry = std::get_if<frames::Odometry>(&frame)) {
      odometry->stamp_ns += shift_ns;
      const Pose2 raw = odometry->odom_from_base;
      // Goes on where it was, with no motion.
      const Pose2 sent = !newest_sent ? raw
                         : newest_raw ? *newest_sent * (newest_raw->Inverse() * raw)
                                      : *newest_sent;
      odometry->odom_from_base = sent;
      newest_raw = raw;
      newest_sent = sent;
    } else {
      std::get<frames::LaserScan>(frame).stamp_ns += shift_ns;
    }
    const auto begin = std::chrono::steady_clock::now();
    const std::vector<PoseEstimate> estimates = Feed(localizer, frame);
    result.worst_call_us =
        std::max(result.worst_call_us,
                 std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin)
                     .count());
    const auto now_truth = truth_at(frames::StampOf(frames[order[k]]));
    if (now_truth) {
      if (carried && last_truth) driven_m += Between(*last_truth, *now_truth);
      const double step_m = last_truth ? Between(*last_truth, *now_truth) : 0.0;
      last_truth = now_truth;
      const auto now = localizer.newest_odometry_ns()
                           ? localizer.At(std::min(*localizer.newest_odometry_ns(),
                                                   frames::StampOf(frame) - lag_ns))
                           : std::nullopt;
      const auto then_truth = now ? truth_at(now->stamp_ns + lag_ns - shift_ns) : std::nullopt;
      if (carried && then_truth) {
        const Pose2 laser = now->map_from_base * LaserInBase(scene);
        const bool right = Between(laser, *then_truth) < 0.5 &&
                           Turn(laser, *then_truth) < geometry::RadFromDeg(10.0);
        if (now->state == State::kTracking && !right) result.wrong_tracking_m += step_m;
        if (now->state != State::kLost && !right) result.wrong_believed_m += step_m;
        if (now->state != State::kTracking && result.noticed_m < 0.0) result.noticed_m = driven_m;
        if (now->state == State::kTracking && right && result.until_right_m < 0.0 &&
            driven_m > 0.0) {
          result.until_right_m = driven_m;
        }
        if (std::holds_alternative<frames::LaserScan>(frame)) {
          truth[now->stamp_ns] = *then_truth;
        }
      } else if (carried && std::holds_alternative<frames::LaserScan>(frame)) {
        if (const auto t = truth_at(frames::StampOf(frames[order[k]]))) {
          truth[frames::StampOf(frame) - lag_ns] = *t;
        }
      }
    }
    done = driven_m > drive_m;
  }
  for (const auto& [stamp_ns, pose] : truth) {
    const auto late = localizer.At(stamp_ns);
    ++result.late_poses;
    if (!late || late->state == State::kLost) continue;
    const Pose2 laser = late->map_from_base * LaserInBase(scene);
    if (Between(laser, pose) < 0.5) {
      ++result.late_right;
      result.late_mean_m += Between(laser, pose);
    } else {
      ++result.late_wrong;
    }
  }
  result.late_mean_m /= std::max(1, result.late_right);
  result.counters = localizer.counters();
  return result;
}

}  // namespace soundmap::localization
