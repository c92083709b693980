#include "sources/simulation/sound_field.h"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <numbers>
#include <random>

#include "tests/simulation/scene_texts.h"

namespace soundmap::simulation {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kSpeedMps = 343.0;
constexpr int kRateHz = 16000;

// channels x samples
std::vector<std::vector<double>> Listen(const Scene& scene, double seconds) {
  const auto trajectory = Trajectory::Create(scene.path, scene.path.laps);
  EXPECT_TRUE(trajectory.ok()) << trajectory.status();
  auto field = SoundField::Create(scene, *trajectory);
  EXPECT_TRUE(field.ok()) << field.status();
  const std::size_t channels = scene.array.microphone_in_array_m.size();
  const auto count = static_cast<std::size_t>(seconds * kRateHz);
  std::vector<std::vector<double>> heard(channels);
  while (heard[0].size() < count) {
    const auto block = (*field)->Next();
    for (std::size_t i = 0; i < block.size(); ++i) heard[i % channels].push_back(block[i]);
  }
  for (auto& channel : heard) channel.resize(count);
  return heard;
}

double Rms(const std::vector<double>& samples) {
  double square = 0.0;
  for (double sample : samples) square += sample * sample;
  return std::sqrt(square / samples.size());
}

struct Arrival {
  double delay_samples, amplitude;
};

// Arrivals of an impulse at sample 0, estimated one by one: the others' closed form is taken off
// the spectrum, what remains is compared with this one's closed form; delay error = slope of the
// phase over the band, amplitude = mean magnitude.
std::vector<Arrival> ErrorsOf(const std::vector<double>& response,
                              const std::vector<Arrival>& expected) {
  std::vector<Arrival> errors;
  const auto spectrum = [](const Arrival& arrival, double omega) {
    return std::polar(arrival.amplitude, -omega * arrival.delay_samples);
  };
  std::vector<double> omegas;
  for (double f_hz = 500.0; f_hz <= 7000.0; f_hz += 50.0)
    omegas.push_back(2 * kPi * f_hz / kRateHz);
  std::vector<std::complex<double>> measured;
  for (double omega : omegas) {
    std::complex<double> sum = 0.0;
    for (std::size_t i = 0; i < response.size(); ++i) sum += std::polar(response[i], -omega * i);
    measured.push_back(sum);
  }
  for (std::size_t k = 0; k < expected.size(); ++k) {
    double slope = 0.0, weight = 0.0, magnitude = 0.0;
    for (std::size_t w = 0; w < omegas.size(); ++w) {
      std::complex<double> rest = measured[w];
      for (std::size_t j = 0; j < expected.size(); ++j) {
        if (j != k) rest -= spectrum(expected[j], omegas[w]);
      }
      const auto ratio = rest / spectrum(expected[k], omegas[w]);
      slope += -std::arg(ratio) * omegas[w];
      weight += omegas[w] * omegas[w];
      magnitude += std::abs(ratio) / omegas.size();
    }
    errors.push_back({slope / weight, magnitude - 1.0});
  }
  return errors;
}

std::vector<double> ClickResponse(const std::vector<double>& channel, int samples) {
  return {channel.begin() + kRateHz / 2, channel.begin() + kRateHz / 2 + samples};
}

Arrival From(const Eigen::Vector3d& source, const Eigen::Vector3d& microphone, double gain) {
  const double distance_m = (source - microphone).norm();
  return {distance_m / kSpeedMps * kRateHz, gain / distance_m};
}

// Two walls reflect, the others swallow: direct sound, one image in each wall, one in both.
TEST(SoundField, ArrivalsOfRandomGeometriesMeetTheClosedForm) {
  std::mt19937 engine(11);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  const char* names[] = {"x_min", "x_max", "y_min", "y_max", "floor", "ceiling"};
  double worst_samples = 0.0;
  for (int round = 0; round < 12; ++round) {
    auto text = StandingScene();
    const Eigen::Vector3d room(8, 7, 3);
    const int wall_a = round % 6, wall_b = (round + 2 + round / 6) % 6;
    nlohmann::json absorption;
    for (int wall = 0; wall < 6; ++wall) absorption[names[wall]] = 1.0;
    absorption[names[wall_a]] = 0.19;  // pressure reflection 0.9
    absorption[names[wall_b]] = 0.36;  // 0.8
    text["reverberation"] = {{"absorption", absorption}, {"image_order", 2}};
    const Eigen::Vector3d source(1 + 6 * uniform(engine), 1 + 5 * uniform(engine),
                                 0.5 + 2 * uniform(engine));
    text["sources"] = {{{"kind", "click"}, {"position", {source.x(), source.y(), source.z()}}}};
    nlohmann::json microphones;
    for (int m = 0; m < 3; ++m) {
      microphones.push_back({0.3 * uniform(engine), 0.3 * uniform(engine), 0.3 * uniform(engine)});
    }
    text["array"] = {{"position_m", {0.1, 0.05, 1.2}},
                     {"rpy_deg", {10, 20, 30}},
                     {"microphones_m", microphones}};
    const double x = 1.5 + 5 * uniform(engine), y = 1.5 + 4 * uniform(engine);
    const double yaw_deg = 360 * uniform(engine);
    text["path"] = {{"way_points", {{x, y}}}, {"standing_s", 2}, {"standing_yaw_deg", yaw_deg}};

    const auto mirrored = [&](Eigen::Vector3d point, int wall) {
      point[wall / 2] = (wall % 2 ? 2 * room[wall / 2] : 0.0) - point[wall / 2];
      return point;
    };
    const auto heard = Listen(Parse(text), 0.65);
    const Eigen::Isometry3d map_from_array =
        Eigen::Translation3d(x, y, 0) *
        Eigen::AngleAxisd(yaw_deg * kPi / 180, Eigen::Vector3d::UnitZ()) *
        Eigen::Translation3d(0.1, 0.05, 1.2) *
        Eigen::AngleAxisd(30 * kPi / 180, Eigen::Vector3d::UnitZ()) *
        Eigen::AngleAxisd(20 * kPi / 180, Eigen::Vector3d::UnitY()) *
        Eigen::Isometry3d(Eigen::AngleAxisd(10 * kPi / 180, Eigen::Vector3d::UnitX()));
    for (int m = 0; m < 3; ++m) {
      const Eigen::Vector3d microphone =
          map_from_array * Eigen::Vector3d(microphones[m][0], microphones[m][1], microphones[m][2]);
      std::vector<Arrival> expected = {From(source, microphone, 1.0),
                                       From(mirrored(source, wall_a), microphone, 0.9),
                                       From(mirrored(source, wall_b), microphone, 0.8)};
      if (wall_a / 2 != wall_b / 2) {
        expected.push_back(From(mirrored(mirrored(source, wall_a), wall_b), microphone, 0.72));
      } else {  // opposite walls: the sound goes either way round
        expected.push_back(From(mirrored(mirrored(source, wall_a), wall_b), microphone, 0.72));
        expected.push_back(From(mirrored(mirrored(source, wall_b), wall_a), microphone, 0.72));
      }
      for (const Arrival& error : ErrorsOf(ClickResponse(heard[m], 2000), expected)) {
        EXPECT_LT(std::abs(error.delay_samples), 0.02);
        EXPECT_NEAR(error.amplitude, 0.0, 0.02);
        worst_samples = std::max(worst_samples, std::abs(error.delay_samples));
      }
    }
  }
  RecordProperty("worst_delay_error_samples", std::to_string(worst_samples));
}

TEST(SoundField, LevelIsTheRmsAtOneMetreAndFallsWithTheDistance) {
  for (double distance_m : {0.5, 1.0, 2.0, 4.0}) {
    auto text = StandingScene();
    text["sources"][0].update({{"position", {3 + distance_m, 3, 1.2}}, {"level", 3}});
    EXPECT_NEAR(Rms(Listen(Parse(text), 4.0)[0]) * distance_m, 3.0, 0.06);
  }
}

// A source flush with a wall keeps its level: it radiates into half the space.
TEST(SoundField, ASourceOnAWallDoesNotDoubleWithItsMirrorImage) {
  auto text = StandingScene();
  text["reverberation"] = {
      {"absorption",
       {{"x_min", 1}, {"x_max", 1}, {"y_min", 1}, {"y_max", 1}, {"floor", 1}, {"ceiling", 0.19}}}};
  text["sources"][0]["position"] = {3, 4, 3};
  EXPECT_NEAR(Rms(Listen(Parse(text), 4.0)[0]) * std::hypot(1.0, 1.8), 1.0, 0.02);
}

// The closed form for the moving robot: the wave meets the microphone where it is when the wave
// arrives.
TEST(SoundField, DelaysFollowTheMovingMicrophone) {
  auto text = StandingScene();
  text["sources"] = {{{"kind", "click"}, {"position", {7.5, 3, 1.2}}, {"level", 1}}};
  text["path"] = {{"way_points", {{0.5, 2}, {7, 2}}},
                  {"closed", false},
                  {"speed_mps", 1.0},
                  {"acceleration_mps2", 2}};
  text["array"]["microphones_m"] = {{0, 0, 0}, {0.1, 0.1, 0.1}};
  const Scene scene = Parse(text);
  const auto trajectory = Trajectory::Create(scene.path, 1.0);
  const auto heard = Listen(scene, 6.0);
  for (int m = 0; m < 2; ++m) {
    for (int click = 0; click < 6; ++click) {
      const int sent = kRateHz / 2 + click * kRateHz;
      double delay_s = 0.0;
      Eigen::Vector3d microphone;
      for (int i = 0; i < 50; ++i) {
        microphone = trajectory->At(static_cast<double>(sent) / kRateHz + delay_s).map_from_base() *
                     (scene.array.base_from_array * scene.array.microphone_in_array_m[m]);
        delay_s = (Eigen::Vector3d(7.5, 3, 1.2) - microphone).norm() / kSpeedMps;
      }
      const std::vector<double> response(heard[m].begin() + sent, heard[m].begin() + sent + 1000);
      const auto error =
          ErrorsOf(response, {From(Eigen::Vector3d(7.5, 3, 1.2), microphone, 1.0)}).front();
      EXPECT_LT(std::abs(error.delay_samples), 0.02) << click;
      EXPECT_NEAR(error.amplitude, 0.0, 0.05) << click;
    }
  }
}

TEST(SoundField, ASweepingToneShowsNoClicksWhileTheRobotMoves) {
  auto text = StandingScene();
  text["sources"] = {{{"kind", "hum"}, {"position", {7.5, 3, 1.2}}}};
  text["path"] = {{"way_points", {{0.5, 2}, {7, 2}}}, {"closed", false}, {"speed_mps", 1.0}};
  // Energy above the hum's last harmonic (4 kHz) and beside its noise: clicks would put some there.
  const auto moving = Listen(Parse(text), 3.0)[0];
  text["path"] = {{"way_points", {{2.0, 2}}}, {"standing_s", 5}};
  const auto standing = Listen(Parse(text), 3.0)[0];
  const auto high = [](const std::vector<double>& samples) {
    double energy = 0.0, total = 0.0;
    for (std::size_t i = 4; i < samples.size(); ++i) {
      const double difference = samples[i] - 4 * samples[i - 1] + 6 * samples[i - 2] -
                                4 * samples[i - 3] + samples[i - 4];
      energy += difference * difference;
      total += samples[i] * samples[i];
    }
    return energy / total;
  };
  EXPECT_NEAR(high(moving) / high(standing), 1.0, 0.15);
}

// Schroeder's backward integral, level of the decay fitted from -5 to -25 dB (T20).
double DecayTimeS(const Scene& scene) {
  const auto heard = Listen(scene, 0.5 + 1.2 * scene.reverberation.rt60_s + 0.1);
  const int samples = static_cast<int>(1.2 * scene.reverberation.rt60_s * kRateHz);
  std::vector<double> left(samples + 1, 0.0);
  for (int i = samples - 1; i >= 0; --i) {
    left[i] = left[i + 1];
    for (const auto& channel : heard) left[i] += std::pow(channel[kRateHz / 2 + i], 2);
  }
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (int i = 0; i < samples; ++i) {
    const double level_db = 10 * std::log10(left[i] / left[0]);
    if (level_db > -5 || level_db < -25) continue;
    const double time_s = static_cast<double>(i) / kRateHz;
    n += 1, sx += time_s, sy += level_db, sxx += time_s * time_s, sxy += time_s * level_db;
  }
  return -60.0 / ((n * sxy - sx * sy) / (n * sxx - sx * sx));
}

TEST(SoundField, DecayMeetsTheReverberationTimeAskedFor) {
  for (double rt60_s : {0.35, 0.8}) {
    for (const auto& [x, y] : {std::pair{8.2, 2.9}, {3.0, 1.5}, {2.0, 4.5}}) {
      auto text = StandingScene();
      text["room_m"] = {10, 7, 2.7};
      text["reverberation"] = {{"rt60_s", rt60_s}};
      text["sources"] = {{{"kind", "click"}, {"position", {2, 1.6, 2.7}}}};
      text["path"]["way_points"] = {{x, y}};
      text["array"] = {{"shape", "dome"}};
      EXPECT_NEAR(DecayTimeS(Parse(text)), rt60_s, 0.1 * rt60_s) << x << " " << y;
    }
  }
}

// Barron's revised theory: a source of 1 at 1 m makes the reverberant power 4 pi c / V * RT60
// / 13.8 * exp(-13.8 t / RT60), t being the time that the direct sound takes.
TEST(SoundField, ReverberantPowerMeetsTheory) {
  auto text = StandingScene();
  text["room_m"] = {10, 7, 4};
  text["reverberation"] = {{"rt60_s", 0.6}, {"image_order", 0}};
  text["sources"][0].update({{"position", {9, 6, 2}}, {"directivity_db", -20}});
  text["array"] = {{"shape", "sphere"}, {"count", 8}, {"radius_m", 0.3}};
  double power = 0.0;
  for (const auto& channel : Listen(Parse(text), 8.0)) power += std::pow(Rms(channel), 2) / 8;
  const double direct_s = Eigen::Vector3d(6, 3, 0.8).norm() / kSpeedMps;
  const double theory =
      4 * kPi * kSpeedMps / 280.0 * 0.6 / 13.8155 * std::exp(-13.8155 * direct_s / 0.6);
  EXPECT_NEAR(power / (100.0 * theory), 1.0, 0.1);
}

TEST(SoundField, TheTailIsCoherentAsADiffuseFieldIs) {
  auto text = StandingScene();
  text["reverberation"] = {{"rt60_s", 0.8}, {"image_order", 0}};
  text["sources"][0].update({{"position", {7.5, 6.5, 2.5}}, {"directivity_db", -20}});
  text["array"]["microphones_m"] = {{0, 0, 0}, {0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}};
  const auto heard = Listen(Parse(text), 9.0);
  constexpr int kFrame = 1024;
  for (double middle_hz : {700.0, 1200.0, 1800.0, 2500.0}) {
    double cross = 0.0, power = 0.0, theory = 0.0;
    constexpr int kBins = 30;
    for (int b = 0; b < kBins; ++b) {
      const double f_hz = middle_hz + (b - kBins / 2) * 31.25;
      const auto step = std::polar(1.0, -2 * kPi * f_hz / kRateHz);
      for (std::size_t start = 0; start + kFrame < heard[0].size(); start += 2 * kFrame) {
        std::complex<double> bin[4] = {}, turn = 1.0;
        for (int i = 0; i < kFrame; ++i, turn *= step) {
          const auto weight = (0.5 - 0.5 * std::cos(2 * kPi * i / kFrame)) * turn;
          for (int m = 0; m < 4; ++m) bin[m] += heard[m][start + i] * weight;
        }
        for (int m = 1; m < 4; ++m) cross += (bin[0] * std::conj(bin[m])).real() / 3;
        for (int m = 0; m < 4; ++m) power += std::norm(bin[m]) / 4;
      }
      const double kd = 2 * kPi * f_hz / kSpeedMps * 0.1;
      theory += std::sin(kd) / kd / kBins;
    }
    EXPECT_NEAR(cross / power, theory, 0.08) << middle_hz;
  }
}

TEST(SoundField, FurnitureWeakensTheDirectSound) {
  auto text = StandingScene();
  const double clear = Rms(Listen(Parse(text), 2.0)[0]);
  text["furniture"] = {{{3.8, 3.2, 0}, {4.2, 3.8, 2}}};
  EXPECT_NEAR(Rms(Listen(Parse(text), 2.0)[0]) / clear, std::pow(10.0, -12.0 / 20), 0.01);
}

TEST(SoundField, SourcesGoOnAndOff) {
  auto text = StandingScene();
  text["sources"][0].update({{"on_s", 0.5}, {"off_s", 1.0}});
  const auto heard = Listen(Parse(text), 1.5)[0];
  const auto part = [&](double from_s, double to_s) {
    return Rms({heard.begin() + static_cast<int>(from_s * kRateHz),
                heard.begin() + static_cast<int>(to_s * kRateHz)});
  };
  EXPECT_LT(part(0.0, 0.5), 1e-3);
  EXPECT_GT(part(0.55, 0.95), 0.3);
  EXPECT_LT(part(1.05, 1.5), 1e-3);
}

TEST(SoundField, SensorNoiseIsIndependentBetweenMicrophones) {
  auto text = StandingScene();
  text["sources"] = nlohmann::json::array();
  text["audio"]["sensor_noise"] = 0.5;
  text["array"]["microphones_m"] = {{0, 0, 0}, {0.1, 0, 0}};
  const auto heard = Listen(Parse(text), 4.0);
  double cross = 0.0;
  for (std::size_t i = 0; i < heard[0].size(); ++i) cross += heard[0][i] * heard[1][i];
  EXPECT_NEAR(Rms(heard[0]), 0.5, 0.005);
  EXPECT_NEAR(Rms(heard[1]), 0.5, 0.005);
  EXPECT_NEAR(cross / heard[0].size() / 0.25, 0.0, 0.02);
}

TEST(SoundField, TheRobotsOwnNoiseTravelsWithIt) {
  auto text = StandingScene();
  text["sources"] = nlohmann::json::array();
  text["audio"]["robot_noise"] = 0.2;
  text["path"] = {{"way_points", {{1, 2}, {7, 2}}}, {"closed", false}, {"speed_mps", 1.0}};
  // From (-0.1, 0, 0.2) to the microphone at (0, 0, 1.2) of the base.
  const double direct = Rms(Listen(Parse(text), 6.0)[0]);
  EXPECT_NEAR(direct, 0.2 / std::hypot(0.1, 1.0), 0.02);
  // The diffuse field of a source has 16 pi / A against 1 / r^2, with the absorption A by Eyring.
  text["reverberation"] = {{"rt60_s", 0.5}, {"image_order", 2}};
  const Scene room = Parse(text);
  const double volume_m3 = room.room_m.prod();
  const double absorption_m2 = 0.161 * volume_m3 / 0.5;
  const double diffuse = 0.2 * std::sqrt(16.0 * std::numbers::pi / absorption_m2);
  // Nearest of all surfaces is the floor, which shows its image at a height of -0.2 m.
  const double floor = 0.2 / std::hypot(0.1, 1.4);
  EXPECT_NEAR(Rms(Listen(room, 6.0)[0]), std::hypot(direct, floor, diffuse), 0.25 * direct);
  EXPECT_GT(Rms(Listen(room, 6.0)[0]), 1.1 * direct);
}

}  // namespace
}  // namespace soundmap::simulation
