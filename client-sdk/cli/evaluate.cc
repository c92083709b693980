#include "cli/evaluate.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "cli/pose_track.h"

namespace soundmap::cli {
namespace {

constexpr double kMinProbability = 0.5;
constexpr double kMaxDistanceM = 1.0;
constexpr std::int64_t kMaxGapNs = 1'000'000'000;
constexpr double kDegPerRad = 180.0 / std::numbers::pi;

double Distance(const Vector3& a, const Vector3& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

double Mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

double PopulationDeviation(const std::vector<double>& values) {
  const double mean = Mean(values);
  double sum = 0.0;
  for (const double value : values) sum += (value - mean) * (value - mean);
  return std::sqrt(sum / static_cast<double>(values.size()));
}

double Quantile(std::vector<double> values, double fraction) {
  std::sort(values.begin(), values.end());
  const double rank = fraction * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(rank);
  if (below + 1 == values.size()) return values[below];
  const double part = rank - static_cast<double>(below);
  return values[below] + part * (values[below + 1] - values[below]);
}

// Collects the errors of a path.
struct PoseErrors {
  std::vector<double> position_m;
  std::vector<double> yaw_deg;

  void Add(const Pose2& estimate, const Pose2& truth) {
    position_m.push_back(std::hypot(estimate.x_m - truth.x_m, estimate.y_m - truth.y_m));
    yaw_deg.push_back(std::abs(WrapAngle(estimate.yaw_rad - truth.yaw_rad)) * kDegPerRad);
  }
};

absl::StatusOr<PoseScore> Score(const std::vector<PoseEstimate>& path, const PoseErrors& errors) {
  if (errors.position_m.empty()) {
    return absl::FailedPreconditionError(
        "no pose of the estimated path falls into the time of the true one");
  }
  const auto lost = std::count_if(path.begin(), path.end(), [](const PoseEstimate& pose) {
    return pose.state == LocalizationState::kLost;
  });
  return PoseScore{.error_mean_m = Mean(errors.position_m),
                   .error_p95_m = Quantile(errors.position_m, 0.95),
                   .yaw_error_mean_deg = Mean(errors.yaw_deg),
                   .lost_fraction = static_cast<double>(lost) / static_cast<double>(path.size())};
}

absl::Status CheckPath(const std::vector<PoseEstimate>& path) {
  if (path.empty()) return absl::FailedPreconditionError("the session has no estimated path");
  for (const PoseEstimate& pose : path) {
    const Pose2& p = pose.map_from_base;
    if (!std::isfinite(p.x_m) || !std::isfinite(p.y_m) || !std::isfinite(p.yaw_rad)) {
      return absl::FailedPreconditionError("a pose of the estimated path is not finite");
    }
  }
  if (!std::is_sorted(path.begin(), path.end(), [](const PoseEstimate& a, const PoseEstimate& b) {
        return a.time_ns < b.time_ns;
      })) {
    return absl::FailedPreconditionError("the estimated path is not in order of time");
  }
  return absl::OkStatus();
}

PoseTrack TrackOf(const std::vector<PoseEstimate>& path) {
  std::vector<StampedPose> poses;
  poses.reserve(path.size());
  for (const PoseEstimate& pose : path) poses.push_back({pose.time_ns, pose.map_from_base});
  return PoseTrack(std::move(poses));
}

// Whether one of the two estimates around a time is lost. `path` is by time.
bool IsLostAt(const std::vector<PoseEstimate>& path, std::int64_t time_ns) {
  const auto after = std::lower_bound(
      path.begin(), path.end(), time_ns,
      [](const PoseEstimate& pose, std::int64_t time) { return pose.time_ns < time; });
  const auto is_lost = [](const PoseEstimate& pose) {
    return pose.state == LocalizationState::kLost;
  };
  return (after != path.end() && is_lost(*after)) ||
         (after != path.begin() && (after == path.end() || after->time_ns != time_ns) &&
          is_lost(*(after - 1)));
}

Eigen::Isometry3d MapFromBase(const Pose2& pose) {
  return Eigen::Translation3d(pose.x_m, pose.y_m, 0.0) *
         Eigen::AngleAxisd(pose.yaw_rad, Eigen::Vector3d::UnitZ());
}

Eigen::Isometry3d TrueRelation(const Relation& relation) {
  const Vector3& t = relation.translation_m;
  return Eigen::Translation3d(t.x, t.y, t.z) *
         Eigen::AngleAxisd(relation.yaw_rad, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(relation.pitch_rad, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(relation.roll_rad, Eigen::Vector3d::UnitX());
}

// What each reported source of some probability belongs to.
struct Assignment {
  struct Match {
    std::size_t reported = 0;
    double distance_m = 0.0;
  };
  std::vector<std::vector<Match>> of_truth;  // nearest first
  std::vector<std::size_t> unmatched;        // of the reported ones
};

Assignment Assign(const std::vector<SoundSource>& reported, const std::vector<TrueSource>& truth,
                  double min_probability) {
  Assignment assignment;
  assignment.of_truth.resize(truth.size());
  for (std::size_t r = 0; r < reported.size(); ++r) {
    if (!(reported[r].probability >= min_probability)) continue;
    Assignment::Match match{r, std::numeric_limits<double>::infinity()};
    std::size_t nearest = 0;
    for (std::size_t t = 0; t < truth.size(); ++t) {
      const double distance_m = Distance(reported[r].position_in_map_m, truth[t].position_in_map_m);
      if (distance_m < match.distance_m) {
        match.distance_m = distance_m;
        nearest = t;
      }
    }
    if (match.distance_m <= kMaxDistanceM) {
      assignment.of_truth[nearest].push_back(match);
    } else {
      assignment.unmatched.push_back(r);
    }
  }
  for (std::vector<Assignment::Match>& matches : assignment.of_truth) {
    std::stable_sort(matches.begin(), matches.end(),
                     [](const auto& a, const auto& b) { return a.distance_m < b.distance_m; });
  }
  return assignment;
}

bool IsInView(const std::vector<bool>& in_view, std::size_t truth) {
  return in_view.empty() || in_view[truth];
}

}  // namespace

SourceScore ScoreSources(const std::vector<SoundSource>& reported,
                         const std::vector<TrueSource>& truth, const std::vector<bool>& in_view) {
  const Assignment assigned = Assign(reported, truth, kMinProbability);
  SourceScore score;
  score.false_count = static_cast<int>(assigned.unmatched.size());
  std::vector<double> errors_m;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    if (!IsInView(in_view, i)) {
      ++score.out_of_view;
      continue;
    }
    ++score.true_count;
    const std::vector<Assignment::Match>& matches = assigned.of_truth[i];
    if (matches.empty()) continue;
    ++score.detected;
    score.double_count += static_cast<int>(matches.size()) - 1;
    errors_m.push_back(matches.front().distance_m);
  }
  if (!errors_m.empty()) {
    score.error_mean_m = Mean(errors_m);
    score.error_std_m = PopulationDeviation(errors_m);
  }
  return score;
}

std::vector<Candidate> JudgeCandidates(const std::vector<SoundSource>& reported,
                                       const std::vector<TrueSource>& truth,
                                       const std::vector<bool>& in_view) {
  const Assignment assigned = Assign(reported, truth, kCandidateProbability);
  std::vector<Candidate> candidates;
  for (const std::size_t i : assigned.unmatched) candidates.push_back({reported[i].probability});
  for (std::size_t t = 0; t < truth.size(); ++t) {
    if (!IsInView(in_view, t)) continue;
    const std::vector<Assignment::Match>& matches = assigned.of_truth[t];
    for (const Assignment::Match& match : matches) {
      candidates.push_back({reported[match.reported].probability, &match == &matches.front()});
    }
  }
  return candidates;
}

Calibration Calibrate(std::vector<Candidate> candidates) {
  constexpr std::size_t kBins = 10;
  Calibration calibration;
  calibration.candidates = static_cast<int>(candidates.size());
  if (candidates.empty()) return calibration;
  std::stable_sort(
      candidates.begin(), candidates.end(),
      [](const Candidate& a, const Candidate& b) { return a.probability < b.probability; });
  double error = 0.0;
  double brier = 0.0;
  for (std::size_t bin = 0; bin < kBins; ++bin) {
    const std::size_t begin = bin * candidates.size() / kBins;
    const std::size_t end = (bin + 1) * candidates.size() / kBins;
    if (begin == end) continue;
    const auto count = static_cast<double>(end - begin);
    Calibration::Bin& mean = calibration.bins.emplace_back();
    mean.count = static_cast<int>(end - begin);
    for (std::size_t i = begin; i < end; ++i) {
      const double is_source = candidates[i].is_source ? 1.0 : 0.0;
      mean.mean_probability += candidates[i].probability / count;
      mean.share_of_sources += is_source / count;
      brier += std::pow(candidates[i].probability - is_source, 2);
    }
    error += count * std::abs(mean.mean_probability - mean.share_of_sources);
  }
  calibration.expected_error = error / static_cast<double>(candidates.size());
  calibration.brier = brier / static_cast<double>(candidates.size());
  return calibration;
}

absl::StatusOr<PoseScore> ScoreAgainstDrive(const std::vector<PoseEstimate>& path,
                                            const std::vector<StampedPose>& truth) {
  const absl::Status status = CheckPath(path);
  if (!status.ok()) return status;
  const PoseTrack track(truth);
  PoseErrors errors;
  for (const PoseEstimate& estimate : path) {
    if (estimate.state == LocalizationState::kLost) continue;
    if (const auto true_pose = track.At(estimate.time_ns, kMaxGapNs)) {
      errors.Add(estimate.map_from_base, *true_pose);
    }
  }
  return Score(path, errors);
}

absl::StatusOr<PoseScore> ScoreAgainstSurvey(const std::vector<PoseEstimate>& path,
                                             const std::vector<StampedPose>& survey) {
  const absl::Status status = CheckPath(path);
  if (!status.ok()) return status;
  const PoseTrack track = TrackOf(path);
  PoseErrors errors;
  for (const StampedPose& surveyed : survey) {
    const auto estimate = track.At(surveyed.time_ns);
    if (estimate && !IsLostAt(path, surveyed.time_ns)) {
      errors.Add(*estimate, surveyed.map_from_base);
    }
  }
  return Score(path, errors);
}

absl::StatusOr<RelationScore> ScoreRelations(const std::vector<PoseEstimate>& path,
                                             const std::vector<Relation>& relations) {
  const absl::Status status = CheckPath(path);
  if (!status.ok()) return status;
  const PoseTrack track = TrackOf(path);
  RelationScore score;
  std::vector<double> trans_m, rot_deg;
  for (const Relation& relation : relations) {
    const auto pose1 = track.At(relation.time1_ns);
    const auto pose2 = track.At(relation.time2_ns);
    if (!pose1 || !pose2) {
      ++score.outside_path;
      continue;
    }
    const Eigen::Isometry3d estimated = MapFromBase(*pose1).inverse() * MapFromBase(*pose2);
    const Eigen::Isometry3d error = TrueRelation(relation).inverse() * estimated;
    trans_m.push_back(error.translation().norm());
    rot_deg.push_back(
        Eigen::Quaterniond(error.linear()).angularDistance(Eigen::Quaterniond::Identity()) *
        kDegPerRad);
  }
  if (trans_m.empty()) {
    return absl::FailedPreconditionError("no relation falls into the time of the estimated path");
  }
  score.trans_mean_m = Mean(trans_m);
  score.trans_std_m = PopulationDeviation(trans_m);
  score.rot_mean_deg = Mean(rot_deg);
  return score;
}

std::optional<Session> SessionToEvaluate(const std::vector<Session>& sessions) {
  const auto newest =
      std::max_element(sessions.begin(), sessions.end(), [](const Session& a, const Session& b) {
        const auto key = [](const Session& s) {
          return std::tuple(s.purpose == Purpose::kListening, s.create_time_ns, s.id);
        };
        return key(a) < key(b);
      });
  if (newest == sessions.end()) return std::nullopt;
  return *newest;
}

nlohmann::ordered_json ToJson(const SourceScore& score) {
  const auto number = [](const std::optional<double>& value) {
    return value ? nlohmann::ordered_json(*value) : nlohmann::ordered_json(nullptr);
  };
  return {{"true", score.true_count},
          {"detected", score.detected},
          {"out_of_view", score.out_of_view},
          {"error_mean_m", number(score.error_mean_m)},
          {"error_std_m", number(score.error_std_m)},
          {"false", score.false_count},
          {"double", score.double_count}};
}

std::string ToJson(const Evaluation& evaluation) {
  nlohmann::ordered_json document = nlohmann::ordered_json::object();
  if (evaluation.sources) document["sources"] = ToJson(*evaluation.sources);
  if (const auto& pose = evaluation.pose) {
    document["pose"] = {{"error_mean_m", pose->error_mean_m},
                        {"error_p95_m", pose->error_p95_m},
                        {"yaw_error_mean_deg", pose->yaw_error_mean_deg},
                        {"lost_fraction", pose->lost_fraction}};
  }
  if (const auto& relations = evaluation.relations) {
    document["relations"] = {{"trans_mean_m", relations->trans_mean_m},
                             {"trans_std_m", relations->trans_std_m},
                             {"rot_mean_deg", relations->rot_mean_deg}};
  }
  return document.dump();
}

}  // namespace soundmap::cli
