#include "acoustics/config.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace soundmap::acoustics {
namespace {

TEST(AcousticsConfig, PaperIsSectionVI) {
  const AcousticsConfig paper = AcousticsConfig::Paper();
  const FrameLayout layout = FrameLayout::Create(paper, 16000).value();
  EXPECT_EQ(layout.window_samples, 400);
  EXPECT_EQ(layout.frames_per_scan, 10);
  EXPECT_EQ(layout.first_bin, 25);
  EXPECT_EQ(layout.bins, 51);
  EXPECT_EQ(layout.scan_period_samples(), 2000);
  EXPECT_EQ(layout.scan_samples(), 2200);
  EXPECT_EQ(paper.MakeGrid().size(), 61 * 76);
  const auto& thresholds = std::get<DoubleThreshold>(paper.evidence);
  EXPECT_EQ(thresholds.t1, 20.0);
  EXPECT_EQ(thresholds.t2, 30.0);
  EXPECT_EQ(thresholds.p_max, 0.999);
}

TEST(AcousticsConfig, PaperKeepsItsWindowInSamplesAndDefaultInSeconds) {
  EXPECT_EQ(FrameLayout::Create(AcousticsConfig::Paper(), 48000).value().window_samples, 400);
  EXPECT_EQ(FrameLayout::Create(AcousticsConfig::Paper(), 48000).value().bins, 17);
  for (const int rate_hz : {8000, 11025, 16000, 22050, 44100, 48000, 96000, 192000}) {
    const FrameLayout layout = FrameLayout::Create(AcousticsConfig::Default(), rate_hz).value();
    EXPECT_EQ(layout.window_samples % 2, 0) << rate_hz;
    EXPECT_NEAR(layout.window_samples / static_cast<double>(rate_hz), 0.025, 1.0 / rate_hz);
    const double highest_hz = std::min(5000.0, rate_hz / 2.0);
    EXPECT_NEAR(layout.bins, (highest_hz - 1000.0) * 0.025 + 1.0, 1.0) << rate_hz;
    EXPECT_GE(layout.bin_hz(0), 1000.0 - 1e-6);
    EXPECT_LE(layout.bin_hz(layout.bins - 1), highest_hz + 1e-6);
  }
}

TEST(AcousticsConfig, NamesWhatIsWrong) {
  const auto message = [](const AcousticsConfig& config, int rate_hz = 16000) {
    return std::string(FrameLayout::Create(config, rate_hz).status().message());
  };
  AcousticsConfig config;
  config.f_max_hz = 900.0;
  EXPECT_NE(message(config).find("f_max_hz"), std::string::npos);
  config = {};
  config.f_min_hz = 4500.0;
  EXPECT_EQ(message(config, 16000), "");
  EXPECT_NE(message(config, 8000).find("f_min_hz, 4500 Hz, to 4000 Hz"), std::string::npos);
  config = {};
  config.f_min_hz = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(message(config).find("f_min_hz"), std::string::npos);
  config = {};
  config.f_min_hz = 1010.0;
  config.f_max_hz = 1020.0;
  EXPECT_NE(message(config).find("no frequency bin"), std::string::npos);
  config = {};
  config.window_samples = 401;
  EXPECT_NE(message(config).find("window_samples"), std::string::npos);
  config.window_samples = 65536;
  config.frames_per_scan = 10000;
  EXPECT_NE(message(config).find("lasts longer"), std::string::npos);
  config = {};
  config.grid = EqualAreaGrid{.spacing_rad = 1e-5};
  EXPECT_NE(message(config).find("spacing_rad"), std::string::npos);
  config = {};
  config.grid = SectorGrid{.azimuth_min_rad = 1.0, .azimuth_max_rad = 0.0};
  EXPECT_NE(message(config).find("azimuth_max_rad"), std::string::npos);
  config = {};
  config.evidence = DoubleThreshold{.p_max = 1.0};
  EXPECT_NE(message(config).find("p_max"), std::string::npos);
  config.evidence = ScaledPower{.p_min = 0.6, .p_max = 0.5};
  EXPECT_NE(message(config).find("p_min"), std::string::npos);
  EXPECT_NE(message({}, 1000000000).find("1000000000 Hz"), std::string::npos);
}

}  // namespace
}  // namespace soundmap::acoustics
