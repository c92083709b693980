#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "frames/frames.h"

namespace soundmap::frames {
namespace {

Calibration Square() {
  Calibration calibration;
  calibration.mic_in_array_m = {{0.1, 0.1, 0.0}, {-0.1, 0.1, 0.0}, {-0.1, -0.1, 0.0}};
  calibration.audio_sample_rate_hz = 16000;
  return calibration;
}

TEST(Calibration, AcceptsARobotAndOneWithoutMicrophones) {
  EXPECT_TRUE(Square().Validate().ok());
  EXPECT_TRUE(Calibration().Validate().ok());
  Calibration calibration = Square();
  calibration.base_from_array.rotate(Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitX()));
  EXPECT_TRUE(calibration.Validate().ok());
}

TEST(Calibration, NamesWhatIsWrong) {
  const auto message = [](auto change) {
    Calibration calibration = Square();
    change(calibration);
    EXPECT_TRUE(absl::IsInvalidArgument(calibration.Validate()));
    return std::string(calibration.Validate().message());
  };
  EXPECT_THAT(message([](Calibration& c) { c.mic_in_array_m.resize(1); }),
              testing::HasSubstr("1 microphone"));
  EXPECT_THAT(message([](Calibration& c) {
                c.mic_in_array_m.clear();
                for (int i = 0; i < 65; ++i) c.mic_in_array_m.emplace_back(i, 0.0, 0.0);
              }),
              testing::HasSubstr("65"));
  EXPECT_THAT(message([](Calibration& c) { c.mic_in_array_m[2] = c.mic_in_array_m[0]; }),
              testing::AllOf(testing::HasSubstr("mic_0"), testing::HasSubstr("mic_2")));
  EXPECT_THAT(message([](Calibration& c) { c.mic_in_array_m[1].y() = std::nan(""); }),
              testing::HasSubstr("mic_1"));
  EXPECT_THAT(message([](Calibration& c) { c.base_from_lidar.translation().z() = INFINITY; }),
              testing::HasSubstr("not finite"));
  EXPECT_THAT(message([](Calibration& c) { c.audio_sample_rate_hz = 1'000'000'000; }),
              testing::HasSubstr("1000000000 Hz"));
  EXPECT_THAT(message([](Calibration& c) { c.audio_sample_rate_hz = 4000; }),
              testing::HasSubstr("4000 Hz"));
  EXPECT_THAT(message([](Calibration& c) { c.laser_time_increment_s = -0.1; }),
              testing::HasSubstr("laser_time_increment_s"));
  EXPECT_THAT(message([](Calibration& c) { c.laser_time_increment_s = std::nan(""); }),
              testing::HasSubstr("laser_time_increment_s"));
  for (const double wrong_db : {-26.0, 201.0, std::nan(""), HUGE_VAL}) {
    EXPECT_THAT(message([&](Calibration& c) { c.full_scale_spl_db = wrong_db; }),
                testing::HasSubstr("full_scale_spl_db"));
  }
}

}  // namespace
}  // namespace soundmap::frames
