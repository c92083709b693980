#include <array>
#include <map>

#include "pipeline/archive.h"
#include "pipeline/listening.h"
#include "pipeline/records.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

using pipeline::Listening;

// A square room, as coarse as its plan may be: the target is what a drive keeps, not the search.
constexpr int kCells = 40;
constexpr double kCell_m = 0.1;

std::unique_ptr<Listening> NewDrive() {
  static const pipeline::Profile profile = *pipeline::ProfileByName("default");
  static const auto building = [] {
    building::FloorPlan plan(kCells, kCells, kCell_m, {-2.0, -2.0});
    for (int row = 0; row < kCells; ++row) {
      for (int column = 0; column < kCells; ++column) {
        const int edge = std::min({column, row, kCells - 1 - column, kCells - 1 - row});
        plan.at(column, row) = edge == 0 ? building::Cell::kOccupied : building::Cell::kFree;
      }
    }
    return pipeline::PreparedBuilding::Create(profile, {nullptr, plan}).value();
  }();
  frames::Calibration calibration;
  calibration.mic_in_array_m = {{0.1, 0, 0}, {0, 0.1, 0}, {-0.1, 0, 0.05}, {0, -0.1, 0.1}};
  calibration.audio_sample_rate_hz = 16000;
  return Listening::Create(profile, {{"hum", 100.0, 500.0}}, calibration, building,
                           geometry::Pose2{}, /*seed=*/1)
      .value();
}

std::string StateOfADrive(int ticks) {
  const auto drive = NewDrive();
  Listening::Output output;
  for (int tick = 0; tick < ticks; ++tick) {
    const frames::TimeNs stamp_ns = 1'700'000'000'000'000'000 + tick * 50'000'000ll;
    frames::LaserScan scan{stamp_ns, -1.5, 0.05, std::vector<float>(60, 1.9f)};
    frames::LidarScan points{stamp_ns, {{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}}, {}};
    frames::AudioBlock block{stamp_ns, 16000, 4, std::vector<std::int16_t>(800 * 4, 7)};
    const frames::Frame all[] = {frames::Odometry{stamp_ns, {0.01 * tick, 0.0, 0.0}},
                                 std::move(scan), std::move(points), std::move(block)};
    for (const frames::Frame& frame : all) {
      drive->Localize(frame, output);
      drive->Hear(frame, output);
    }
  }
  return drive->SaveState();
}

// What is read is read again from what it is written as.
template <typename Value, typename Encode, typename DecodeAgain>
void GoesRound(const absl::StatusOr<Value>& value, const Encode& encode,
               const DecodeAgain& decode) {
  if (!value.ok()) return;
  const std::string bytes = encode(*value);
  const auto again = decode(bytes);
  Require(again.ok() && encode(*again) == bytes);
}

}  // namespace

// The first byte is the kind.
std::vector<std::string> Seeds() {
  pipeline::SiteRecord site{"hall", "default", "profile = \"default\"\n", 5, 1, {"d"}, "q"};
  site.bands = {{"hum", 100.0, 500.0}};
  pipeline::SessionRecord session;
  session.site = "hall";
  session.calibration.mic_in_array_m = {{0.1, 0.0, 0.0}};
  session.initial_pose = geometry::Pose2{1.0, 2.0, 3.0};
  session.gaps = {{3, 4, 5, 6, "full"}};
  session.clock_offsets = {{1, 2, 3, 100.0}};
  pipeline::AudioScanInfo scan;
  scan.robot = "robot";
  scan.peaks = {{Eigen::Vector3d(0, 0, 1), 17.0}, {Eigen::Vector3d(0, 1, 0), 5.0}};
  scan.heard.resize(2);
  sound_map::SourceRegister::State sources;
  sources.tracks.resize(2);
  sources.tracks[0].source.robots = {"robot"};
  sources.tracks[0].source.heard = {{1, 2}, {3, 4}};
  sources.tracks[0].source.view_points.resize(3);
  return {'\0' + ToJson(site),
          '\1' + ToJson(session),
          '\2' + pipeline::EncodePose(scan.pose),
          '\3' + pipeline::EncodeAudioScan(scan),
          '\4' + pipeline::EncodeSourceRegisters({sources, {}}),
          '\5' + StateOfADrive(0),
          '\5' + StateOfADrive(12)};
}

void Decode(std::string_view input) {
  if (input.empty()) return;
  const std::string bytes(input.substr(1));
  switch (static_cast<unsigned char>(input[0]) % 6) {
    case 0:
      GoesRound(
          pipeline::SiteRecordFromJson(bytes), [](const auto& record) { return ToJson(record); },
          pipeline::SiteRecordFromJson);
      break;
    case 1:
      GoesRound(
          pipeline::SessionRecordFromJson(bytes), [](const auto& record) { return ToJson(record); },
          pipeline::SessionRecordFromJson);
      break;
    case 2:
      GoesRound(pipeline::DecodePose(bytes), pipeline::EncodePose, pipeline::DecodePose);
      break;
    case 3:
      GoesRound(pipeline::DecodeAudioScan(bytes), pipeline::EncodeAudioScan,
                pipeline::DecodeAudioScan);
      break;
    case 4:
      GoesRound(pipeline::DecodeSourceRegisters(bytes), pipeline::EncodeSourceRegisters,
                pipeline::DecodeSourceRegisters);
      break;
    default: {
      static const std::unique_ptr<Listening> drive = NewDrive();
      if (!drive->RestoreState(bytes).ok()) return;
      const std::string state = drive->SaveState();
      const absl::Status restored = drive->RestoreState(state);
      Require(restored.ok() && drive->SaveState() == state);
    }
  }
}

}  // namespace soundmap::fuzz
