#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "cli/pose_file.h"
#include "cli/truth_file.h"
#include "soundmap/poses.h"
#include "soundmap/resources.h"
#include "soundmap/sound.h"

// How far a sound map and an estimated path are from what is true.
namespace soundmap::cli {

struct SourceScore {
  int true_count = 0;  // in view
  int detected = 0;    // of them
  int out_of_view = 0;
  int false_count = 0;
  int double_count = 0;
  // Distance of the detections from their true sources; the deviation is the population's. None
  // without a detection.
  std::optional<double> error_mean_m;
  std::optional<double> error_std_m;
};

// Each reported source with probability >= 0.5 goes to the nearest true one within 1.0 m (of two
// equally near, the first). The nearest of those at one true source is its detection, the others
// are double; what went to none is false; what went to a source out of view counts nowhere.
// `in_view` has an entry for each true source, or is empty: all are.
SourceScore ScoreSources(const std::vector<SoundSource>& reported,
                         const std::vector<TrueSource>& truth, const std::vector<bool>& in_view);

// A reported source of whatever probability, and whether there is one.
struct Candidate {
  double probability = 0.0;
  bool is_source = false;
};

// Reported sources of at least this probability, the rule of ScoreSources() applied to all of them:
// the detection of a true source is one, doubles and false ones are none.
constexpr double kCandidateProbability = 0.2;
std::vector<Candidate> JudgeCandidates(const std::vector<SoundSource>& reported,
                                       const std::vector<TrueSource>& truth,
                                       const std::vector<bool>& in_view);

// How well probabilities tell shares: the expected calibration error is the mean distance between
// the mean probability and the share of sources over ten bins of equal count, weighted by their
// count; the Brier score is the mean of (probability - is_source)^2.
struct Calibration {
  struct Bin {
    double mean_probability = 0.0;
    double share_of_sources = 0.0;
    int count = 0;
  };
  int candidates = 0;
  std::vector<Bin> bins;  // by probability
  std::optional<double> expected_error;
  std::optional<double> brier;
};
Calibration Calibrate(std::vector<Candidate> candidates);

struct PoseScore {
  double error_mean_m = 0.0;
  double error_p95_m = 0.0;  // linear between order statistics
  double yaw_error_mean_deg = 0.0;
  double lost_fraction = 0.0;
};

// Errors of the estimates that are not lost; `lost_fraction` is the share of all estimates that
// are. The path is by time. FailedPrecondition: no estimate, or none at a time that the truth
// knows.
//
// A drive's truth is dense: it is interpolated (over at most 1 s) at the time of each estimate.
absl::StatusOr<PoseScore> ScoreAgainstDrive(const std::vector<PoseEstimate>& path,
                                            const std::vector<StampedPose>& truth);
// Surveyed poses may be far apart: the estimated path is interpolated at the time of each.
absl::StatusOr<PoseScore> ScoreAgainstSurvey(const std::vector<PoseEstimate>& path,
                                             const std::vector<StampedPose>& survey);

// The metric of the SLAM benchmark (Kuemmerle et al. 2009): the estimated pose at t2 as seen from
// t1 against the true one, length of the difference in translation and angle of the difference in
// rotation, over all relations; the deviation is the population's.
struct RelationScore {
  double trans_mean_m = 0.0;
  double trans_std_m = 0.0;
  double rot_mean_deg = 0.0;
  int outside_path = 0;  // relations that were left out, since the path does not reach their times
};

absl::StatusOr<RelationScore> ScoreRelations(const std::vector<PoseEstimate>& path,
                                             const std::vector<Relation>& relations);

// The newest listening session; if there is none, the newest of all.
std::optional<Session> SessionToEvaluate(const std::vector<Session>& sessions);

struct Evaluation {
  std::optional<SourceScore> sources;
  std::optional<PoseScore> pose;
  std::optional<RelationScore> relations;
};

// A figure that does not exist is null.
nlohmann::ordered_json ToJson(const SourceScore& score);
// One JSON document; a part that was not evaluated is absent, a figure that does not exist is null.
std::string ToJson(const Evaluation& evaluation);

}  // namespace soundmap::cli
