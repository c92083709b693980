#include "pipeline/sites.h"

#include <gtest/gtest.h>

#include <boost/asio/thread_pool.hpp>
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
