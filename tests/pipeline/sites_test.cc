#include "pipeline/sites.h"

#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
#include <cmath>
#include <filesystem>

namespace soundmap::pipeline {
namespace {

class QuietContext : public OperationContext {
 public:
  void Report(double, const std::string&) override {}
  bool cancelled() const override { return false; }
};

class SitesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
    Open();
  }
  void TearDown() override {
    Close();
    std::filesystem::remove_all(folder_);
  }

  void Open() {
    store_ = storage::Store::Open(folder_.string()).value();
    sites_ =
        Sites::Open(store_.get(), {pool_.get_executor(),
                                   [](const recording::Message&,
                                      const frames::Calibration&) -> absl::StatusOr<frames::Frame> {
                                     return absl::InvalidArgumentError("no frames are sent here");
                                   },
                                   ProfileByName, [this] { return ++now_ns_; }})
            .value();
  }
  void Close() {
    sites_.reset();
    store_.reset();
  }

  absl::StatusCode BuildMap(const MapRequest& request) {
    QuietContext context;
    return (*sites_->Get("hall"))->BuildMap(request, context).status().code();
  }

  std::filesystem::path folder_;
  boost::asio::thread_pool pool_{1};
  std::int64_t now_ns_ = 0;
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<Sites> sites_;
};

TEST_F(SitesTest, ARequestThatIsRepeatedGivesTheSameSite) {
  const auto hall = sites_->Create("hall", "", "request-1");
  ASSERT_TRUE(hall.ok()) << hall.status();
  EXPECT_EQ(*sites_->Create("hall", "", "request-1"), *hall);
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("hall", "", "request-2").status()));
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("hall", "", "").status()));
  ASSERT_TRUE(sites_->Create("yard", "", "").ok());
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("yard", "", "").status()));

  Close();
  Open();
  EXPECT_TRUE(sites_->Create("hall", "", "request-1").ok());
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("hall", "", "request-2").status()));
}

TEST_F(SitesTest, TheBandsOfASiteStay) {
  const std::vector<Band> bands = {{"hiss", 4000.0, 8000.0}, {"hum", 100.0, 500.0}};
  const auto hall = sites_->Create("hall", "", "request-1", bands);
  ASSERT_TRUE(hall.ok()) << hall.status();
  EXPECT_EQ((*hall)->bands(), bands);
  EXPECT_EQ((*hall)->region().band_count(), 3u);
  EXPECT_EQ(*sites_->Create("hall", "", "request-1", bands), *hall);
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("hall", "", "request-1").status()));
  EXPECT_TRUE(absl::IsAlreadyExists(sites_->Create("hall", "", "request-1", {bands[0]}).status()));
  EXPECT_EQ((*hall)->FindBand("").value(), kMainBand);
  EXPECT_EQ((*hall)->FindBand("hum").value(), 2);
  EXPECT_EQ((*hall)->BandName(2), "hum");
  EXPECT_EQ((*hall)->BandName(kMainBand), "");
  EXPECT_EQ((*hall)->FindBand("hom").status(),
            absl::NotFoundError("site 'hall' has no band 'hom'; it has hiss, hum"));

  Close();
  Open();
  EXPECT_EQ(sites_->Get("hall").value()->bands(), bands);
  EXPECT_TRUE(sites_->Create("hall", "", "request-1", bands).ok());
  EXPECT_EQ(sites_->Create("yard", "", "").value()->FindBand("hum").status(),
            absl::NotFoundError("site 'yard' has no band 'hum'; it has none"));
}

TEST_F(SitesTest, ABandThatCannotBeIsNamed) {
  const auto refusal = [this](const std::vector<Band>& bands) {
    const absl::Status status = sites_->Create("hall", "", "", bands).status();
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_TRUE(absl::IsNotFound(sites_->Get("hall").status()));
    return std::string(status.message());
  };
  const Band hum{"hum", 100.0, 500.0};
  EXPECT_EQ(refusal({hum, {"low", -1.0, 500.0}}),
            "the band 'low' cannot be heard: acoustics.f_min_hz is -1; it must be from 0 to 96000");
  EXPECT_EQ(refusal({hum, {"back", 500.0, 100.0}}),
            "the band 'back' cannot be heard: acoustics.f_max_hz is 100; it must be from 500 to "
            "96000");
  EXPECT_NE(refusal({{"nan", std::nan(""), 100.0}}).find("'nan'"), std::string::npos);
  EXPECT_NE(refusal({{"bats", 100.0, 1e9}}).find("'bats'"), std::string::npos);
  EXPECT_EQ(refusal({hum, hum}), "the band 'hum' is given twice");
  EXPECT_NE(refusal({{"Hum", 100.0, 500.0}}).find("the band name \"Hum\""), std::string::npos);
  EXPECT_NE(refusal({{"", 100.0, 500.0}}).find("the band name \"\""), std::string::npos);
  std::vector<Band> many;
  for (char name = 'a'; name <= 'i'; ++name) many.push_back({std::string(1, name), 100.0, 500.0});
  EXPECT_EQ(refusal(many), "a site has at most 8 bands, not 9");
  many.pop_back();
  EXPECT_TRUE(sites_->Create("hall", "", "", many).ok());
}

TEST_F(SitesTest, SaysWhatAMapCannotBeMadeOf) {
  const auto hall = sites_->Create("hall", "", "").value();
  EXPECT_EQ(BuildMap({}), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(BuildMap({.sessions = {"drive"}}), absl::StatusCode::kNotFound);
  EXPECT_EQ(BuildMap({.extend = true}), absl::StatusCode::kFailedPrecondition);
  ASSERT_TRUE(
      hall->CreateSession({.session = "drive", .robot = "r", .purpose = Purpose::kMapping}, 1)
          .ok());
  EXPECT_EQ(BuildMap({.sessions = {"drive"}}), absl::StatusCode::kFailedPrecondition)
      << "it has not arrived in full";
  EXPECT_EQ(BuildMap({}), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(hall->building(), nullptr);
  EXPECT_TRUE(absl::IsFailedPrecondition(
      hall->CreateSession({.session = "listen", .robot = "r"}, 1).status()))
      << "there is no map to listen in";
}

}  // namespace
}  // namespace soundmap::pipeline
