#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "building/building.h"
#include "cli/drive_truth.h"
#include "cli/evaluate.h"
#include "cli/truth_file.h"
#include "frames/frames.h"
#include "pipeline/profile.h"
#include "sound_map/registered_source.h"

// Drives with truth, straight through the pipeline in this process, and how far what it found is
// from what is true.
namespace soundmap::acceptance {

// A drive through a building that was mapped before.
struct Trial {
  std::string name;
  frames::Calibration calibration;
  std::vector<frames::Frame> frames;
  cli::SceneTruth scene;
  cli::DriveTruth truth;
  geometry::Pose2 start;
  std::shared_ptr<const building::Building> building;

  bool planar() const;  // the microphones lie in a plane
};

// The drive, the mapping drive of its building, and NAME.truth.json beside the drive. The building
// is made once and kept beside the mapping drive (NAME.building).
absl::StatusOr<Trial> ReadTrial(const std::string& drive_path, const std::string& mapping_path);

// What is asked of a random scene beside its seed.
struct RoomVariant {
  bool silent = false;            // no source, but noise: of microphones and of the robot itself
  std::optional<double> seconds;  // the drive lasts so long
};

// simulation::RandomScene(); drives and building are made once and kept in the folder.
absl::StatusOr<Trial> RandomTrial(std::uint64_t seed, const RoomVariant& variant,
                                  const std::string& folder);

// What may be wrong with a robot; changes its drive or what is known of it.
enum class Fault { kNone, kDeadMicrophone, kInvertedMicrophone, kGains, kArrayOffset, kLostAudio };
void Inject(Fault fault, Trial& trial);

struct SourceResult {
  std::string kind;
  double level = 0.0;
  bool in_view = false;
  std::optional<double> error_m;  // none: missed
  int doubles = 0;
};

struct TrialResult {
  std::vector<SourceResult> sources;
  int false_count = 0;
  std::vector<cli::Candidate> candidates;
  std::vector<sound_map::RegisteredSource> found;
  std::vector<std::string> warnings;
  std::int64_t scans = 0;
  double peaks_per_scan = 0.0;
  double pose_error_m = 0.0;

  int in_view() const;
  int detected() const;
  int doubles() const;
};

absl::StatusOr<TrialResult> Run(const Trial& trial, const pipeline::Profile& profile);

// Over many trials.
struct Summary {
  int in_view = 0;
  int detected = 0;
  int false_count = 0;
  int doubles = 0;
  std::vector<double> errors_m;  // sorted
  std::vector<cli::Candidate> candidates;

  void Add(const TrialResult& result);
  double recall() const;
  double precision() const;  // neither false nor double
  double ErrorQuantile(double share) const;
};

}  // namespace soundmap::acceptance
