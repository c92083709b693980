#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>

#include "acoustics/audio_scanner.h"
#include "api/decode_frame.h"
#include "geometry/angles.h"
#include "geometry/voxel_key.h"
#include "ray_casting/ray_caster.h"
#include "recording/drive.h"
#include "sound_map/sound_map.h"
#include "sound_map/sound_sources.h"
#include "tests/acoustics/plane_waves.h"

// From samples and LIDAR points to sound sources, twice: as the server does, and by the paper's
// equations as printed: in double precision, every direction with every microphone and every point.
namespace soundmap {
namespace {

using acoustics::testing::Microphones;

constexpr frames::TimeNs kBegin_ns = 1'700'000'000'000'000'000;
// Of the bound B: what SrpPhat promises.
constexpr double kPowerTolerance = 1e-5;

// One audio scan and what the LIDAR saw then.
struct Moment {
  std::vector<std::int16_t> samples;
  std::vector<Eigen::Vector3f> point_in_base;
  geometry::Pose2 map_from_base;
};

class BothWays {
 public:
  explicit BothWays(const frames::Calibration& calibration)
      : calibration_(calibration),
        config_(ConfigFor(calibration)),
        layout_(acoustics::FrameLayout::Create(config_, calibration.audio_sample_rate_hz).value()),
        caster_(ray_casting::RayCaster::Create(casting_, config_.MakeGrid(),
                                               calibration.base_from_array)
                    .value()),
        fast_map_(sound_map::SoundMap::Create(sound_map::PaperConfig()).value()),
        plain_map_(sound_map::SoundMap::Create(sound_map::PaperConfig()).value()) {}

  const acoustics::FrameLayout& layout() const { return layout_; }

  void Hear(const Moment& moment) {
    const frames::TimeNs stamp_ns = kBegin_ns + frames::NsFromSeconds(1.0) * scans_++;
    auto scanner = acoustics::AudioScanner::Create(config_, calibration_).value();
    const auto fast =
        scanner
            ->Push({stamp_ns, calibration_.audio_sample_rate_hz,
                    static_cast<int>(calibration_.mic_in_array_m.size()), moment.samples})
            .value();
    ASSERT_EQ(fast.size(), 1u);
    ASSERT_EQ(fast[0].fault, "");
    const std::vector<float> plain = PlainLikelihood(moment, fast[0].likelihood);

    localization::PoseEstimate pose;
    pose.stamp_ns = fast[0].mid_ns();
    pose.map_from_base = moment.map_from_base;
    pose.state = localization::State::kTracking;
    const auto evidence =
        caster_.Cast(fast[0], {fast[0].mid_ns(), moment.point_in_base}, pose).value();
    const sound_map::EvidenceScan plain_evidence{fast[0].mid_ns(), PlainCast(moment, plain)};
    ASSERT_EQ(evidence.end_points.size(), plain_evidence.end_points.size());
    for (std::size_t i = 0; i < evidence.end_points.size(); ++i) {
      ASSERT_EQ(evidence.end_points[i].key, plain_evidence.end_points[i].key);
    }
    end_points_ += evidence.end_points.size();
    ASSERT_TRUE(fast_map_->Apply(evidence).ok());
    ASSERT_TRUE(plain_map_->Apply(plain_evidence).ok());
  }

  void ExpectSameMapAndSources() {
    std::map<geometry::VoxelKey, float> plain_log_odds;
    plain_map_->TakeSnapshot()->ForEach(
        [&](const geometry::VoxelKey& key, const sound_map::Voxel& voxel) {
          plain_log_odds[key] = voxel.log_odds;
          return true;
        });
    std::size_t voxels = 0;
    fast_map_->TakeSnapshot()->ForEach(
        [&](const geometry::VoxelKey& key, const sound_map::Voxel& voxel) {
          ++voxels;
          const auto plain = plain_log_odds.find(key);
          different_ += plain == plain_log_odds.end() || plain->second != voxel.log_odds ? 1 : 0;
          sounding_ += voxel.log_odds > 0.0f ? 1 : 0;
          return true;
        });
    ASSERT_EQ(voxels, plain_log_odds.size());
    EXPECT_LE(different_, on_the_edge_);
    const auto fast = sound_map::FindSoundSources(*fast_map_->TakeSnapshot(), sources_);
    const auto plain = sound_map::FindSoundSources(*plain_map_->TakeSnapshot(), sources_);
    ASSERT_EQ(fast.size(), plain.size());
    for (std::size_t i = 0; i < fast.size(); ++i) {
      // Without a power between two thresholds there is no difference at all.
      EXPECT_TRUE(on_the_edge_ > 0 || fast[i] == plain[i]);
      EXPECT_LT((fast[i].position_in_map_m - plain[i].position_in_map_m).norm(), 0.01);
      EXPECT_NEAR(fast[i].probability, plain[i].probability, 0.01);
    }
    EXPECT_GT(end_points_, 100u * scans_);
    sources_found_ += fast.size();
  }

  std::size_t sources_found() const { return sources_found_; }
  int on_the_edge() const { return on_the_edge_; }
  int sounding() const { return sounding_; }

 private:
  // Thresholds above what incoherent noise gives, B / N, which weak sources cross as well.
  static acoustics::AcousticsConfig ConfigFor(const frames::Calibration& calibration) {
    acoustics::AcousticsConfig config = acoustics::AcousticsConfig::Paper();
    const auto layout =
        acoustics::FrameLayout::Create(config, calibration.audio_sample_rate_hz).value();
    const double incoherent =
        static_cast<double>(layout.bins) / static_cast<double>(calibration.mic_in_array_m.size());
    auto& thresholds = std::get<acoustics::DoubleThreshold>(config.evidence);
    thresholds.t1 = 2.0 * incoherent;
    thresholds.t2 = 3.0 * incoherent;
    return config;
  }

  // Eqs. (1)-(6) as printed. Where the power lies within the tolerance of a threshold, either
  // class is right.
  std::vector<float> PlainLikelihood(const Moment& moment, const std::vector<float>& fast) {
    const auto& thresholds = std::get<acoustics::DoubleThreshold>(config_.evidence);
    const auto spectra = acoustics::testing::LiteralPhat(
        layout_, static_cast<int>(calibration_.mic_in_array_m.size()), moment.samples);
    const double tolerance = kPowerTolerance * layout_.bins;
    const geometry::DirectionGrid grid = config_.MakeGrid();
    std::vector<float> likelihood;
    for (int i = 0; i < grid.size(); ++i) {
      const double power =
          acoustics::testing::LiteralPower(layout_, calibration_.mic_in_array_m, spectra, grid[i]);
      likelihood.push_back(static_cast<float>(power < thresholds.t1   ? thresholds.p_min
                                              : power > thresholds.t2 ? thresholds.p_max
                                                                      : thresholds.p_med));
      if (likelihood.back() == fast[i]) continue;
      ++on_the_edge_;
      EXPECT_LT(std::min(std::abs(power - thresholds.t1), std::abs(power - thresholds.t2)),
                tolerance)
          << "direction " << i;
    }
    return likelihood;
  }

  // Section V as written, but with v_L from O_a to M_j.
  std::vector<sound_map::EndPoint> PlainCast(const Moment& moment,
                                             const std::vector<float>& likelihood) const {
    const Eigen::Isometry3d& base_from_array = calibration_.base_from_array;
    std::vector<Eigen::Vector3d> v_l;
    std::vector<double> range_m;
    for (const Eigen::Vector3f& point : moment.point_in_base) {
      const Eigen::Vector3d away = point.cast<double>() - base_from_array.translation();
      range_m.push_back(away.norm());
      v_l.push_back(away / away.norm());
    }
    const double epsilon = 1.0 - std::cos(geometry::RadFromDeg(casting_.max_angle_deg));
    const geometry::DirectionGrid grid = config_.MakeGrid();
    std::vector<sound_map::EndPoint> end_points;
    for (int i = 0; i < grid.size(); ++i) {
      const Eigen::Vector3d v_a = base_from_array.linear() * grid[i];
      double least = epsilon;
      std::optional<std::size_t> nearest;
      for (std::size_t j = 0; j < v_l.size(); ++j) {
        const double cost = 1.0 - v_l[j].dot(v_a);
        if (cost >= least) continue;
        least = cost;
        nearest = j;
      }
      if (!nearest || range_m[*nearest] > casting_.max_range_m) continue;
      const auto key = geometry::KeyFromPoint(
          moment.map_from_base.ToIsometry() * base_from_array * (range_m[*nearest] * grid[i]),
          casting_.voxel_size_m);
      if (key) end_points.push_back({*key, likelihood[i]});
    }
    return end_points;
  }

  const frames::Calibration calibration_;
  const acoustics::AcousticsConfig config_;
  const ray_casting::RayCastingConfig casting_ = ray_casting::PaperConfig();
  const sound_map::SoundSourceConfig sources_ = sound_map::PaperConfig().sources;
  const acoustics::FrameLayout layout_;
  const ray_casting::RayCaster caster_;
  std::unique_ptr<sound_map::SoundMap> fast_map_;
  std::unique_ptr<sound_map::SoundMap> plain_map_;
  int scans_ = 0;
  int on_the_edge_ = 0;  // directions whose power is as near to a threshold as rounding
  int different_ = 0;    // voxels
  int sounding_ = 0;     // voxels with L > 0
  std::size_t end_points_ = 0;
  std::size_t sources_found_ = 0;
};

// The walls of a room around the robot, a source in front of one of them, three places.
TEST(FastPaths, RandomRoomsHaveTheSourcesOfThePlainPaths) {
  std::mt19937_64 random(1);
  const auto uniform = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  std::size_t sources = 0;
  int on_the_edge = 0;
  for (int scene = 0; scene < 20; ++scene) {
    SCOPED_TRACE(scene);
    const Microphones microphones =
        acoustics::testing::RandomArray(6 + 2 * (scene % 6), uniform(0.08, 0.2), random);
    frames::Calibration calibration = acoustics::testing::CalibrationOf(microphones, 16000);
    calibration.base_from_array =
        Eigen::Translation3d(uniform(-0.2, 0.2), uniform(-0.2, 0.2), uniform(0.5, 1.2)) *
        Eigen::AngleAxisd(uniform(-0.3, 0.3), acoustics::testing::RandomDirection(random));
    BothWays both(calibration);
    const Eigen::Vector3d room_m(uniform(4.0, 8.0), uniform(4.0, 8.0), uniform(2.4, 3.5));
    const Eigen::Vector3d source_in_map(room_m.x() - 0.1, uniform(0.4, 0.6) * room_m.y(),
                                        uniform(0.8, 1.8));
    for (int place = 0; place < 3; ++place) {
      Moment moment;
      moment.map_from_base = {uniform(0.3, 0.5) * room_m.x(), uniform(0.35, 0.65) * room_m.y(),
                              uniform(-0.3, 0.3)};
      const Eigen::Isometry3d map_from_base = moment.map_from_base.ToIsometry();
      const Eigen::Vector3d lidar_in_base(0.1, 0.0, 0.8);
      const Eigen::Vector3d lidar_in_map = map_from_base * lidar_in_base;
      for (int ring = -20; ring <= 20; ++ring) {
        for (int beam = 0; beam < 120; ++beam) {
          const Eigen::Vector3d direction =
              geometry::DirectionFromAngles(geometry::RadFromDeg(3.0 * beam + uniform(-0.1, 0.1)),
                                            geometry::RadFromDeg(2.0 * ring));
          double range_m = 100.0;
          for (int axis = 0; axis < 3; ++axis) {
            const double along = (map_from_base.linear() * direction)[axis];
            const double wall_m = along > 0.0 ? room_m[axis] : 0.0;
            if (along != 0.0) range_m = std::min(range_m, (wall_m - lidar_in_map[axis]) / along);
          }
          moment.point_in_base.push_back(
              (lidar_in_base + (range_m + uniform(-0.02, 0.02)) * direction).cast<float>());
        }
      }
      const Eigen::Isometry3d map_from_array = map_from_base * calibration.base_from_array;
      moment.samples = acoustics::testing::Record(
          microphones, 16000, both.layout().scan_samples(),
          {{(map_from_array.inverse() * source_in_map).normalized(), uniform(500.0, 3000.0)}},
          uniform(50.0, 500.0), random);
      ASSERT_NO_FATAL_FAILURE(both.Hear(moment));
    }
    ASSERT_NO_FATAL_FAILURE(both.ExpectSameMapAndSources());
    sources += both.sources_found();
    on_the_edge += both.on_the_edge();
  }
  EXPECT_GT(sources, 10u);
  RecordProperty("on_the_edge", on_the_edge);
}

// A scan every other second of the recorded drive, from its true poses.
TEST(FastPaths, TheGrillRoomHasTheSourcesOfThePlainPaths) {
  const char* folder = std::getenv("SOUNDMAP_DATA");
  const std::filesystem::path data =
      folder != nullptr ? std::filesystem::path(folder)
                        : std::filesystem::path(SOUNDMAP_SOURCE_DIR) / ".." / "shared" / "data";
  const std::string path = data / "grill_room" / "drive.mcap";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "there is no " << path;
  const auto survey = recording::SurveyDrive(path).value();
  const auto model = recording::MakeRobotModel(survey.transforms, survey.audio_channels).value();
  frames::Calibration calibration;
  calibration.base_from_array = model.base_from_array.value();
  calibration.base_from_lidar = model.base_from_lidar.value();
  calibration.mic_in_array_m = model.mic_in_array_m;
  calibration.audio_sample_rate_hz = survey.audio_sample_rate_hz;
  const auto poses = recording::ReadGroundTruth(path).value();

  BothWays both(calibration);
  const std::size_t scan_values =
      static_cast<std::size_t>(both.layout().scan_samples()) * calibration.mic_in_array_m.size();
  auto reader = recording::Reader::Open(path).value();
  Moment moment;
  frames::TimeNs next_ns = 0;
  while (const auto message = reader->Next().value()) {
    if (message->topic != recording::kAudioTopic && message->topic != recording::kLidarTopic) {
      continue;
    }
    auto frame = api::DecodeFrame(message->schema, message->data, calibration).value();
    if (const auto* lidar = std::get_if<frames::LidarScan>(&frame)) {
      moment.point_in_base.clear();
      for (const Eigen::Vector3f& point : lidar->point_in_lidar) {
        moment.point_in_base.push_back(calibration.base_from_lidar.cast<float>() * point);
      }
    } else if (const auto* audio = std::get_if<frames::AudioBlock>(&frame)) {
      if (moment.point_in_base.empty() || audio->stamp_ns < next_ns) continue;
      moment.samples.insert(moment.samples.end(), audio->samples.begin(), audio->samples.end());
      if (moment.samples.size() < scan_values) continue;
      moment.samples.resize(scan_values);
      const auto pose = std::find_if(poses.begin(), poses.end(), [&](const auto& stamped) {
        return stamped.time_ns >= audio->stamp_ns;
      });
      if (pose == poses.end()) break;
      moment.map_from_base = geometry::ProjectToFloor(pose->map_from_base);
      ASSERT_NO_FATAL_FAILURE(both.Hear(moment));
      moment.samples.clear();
      next_ns = audio->stamp_ns + frames::NsFromSeconds(2.0);
    }
  }
  ASSERT_NO_FATAL_FAILURE(both.ExpectSameMapAndSources());
  EXPECT_GT(both.sounding(), 0);
  RecordProperty("on_the_edge", both.on_the_edge());
  RecordProperty("sources", static_cast<int>(both.sources_found()));
}

}  // namespace
}  // namespace soundmap
