#include "pipeline/live_robots.h"

#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "pipeline/events.h"

namespace soundmap::pipeline {
namespace {

constexpr std::int64_t kNow_ns = 1'700'000'000'000'000'000;

LiveView Seen(double x_m, bool with_laser = false) {
  LiveView view{.session = std::string("d")};
  view.report.odometry = frames::Odometry{1, {x_m, 0.0, 0.0}};
  if (with_laser) view.report.laser = std::make_shared<frames::LaserScan>();
  return view;
}

class LiveRobotsTest : public testing::Test {
 protected:
  // What the robot said last; -1: it is not live.
  double X(const std::string& robot = "r") const {
    const auto view = robots_.Find(robot);
    return view ? view->report.odometry->odom_from_base.x_m : -1.0;
  }

  EventRing events_;
  LiveRobots robots_{&events_};
};

TEST_F(LiveRobotsTest, TheNewestReportCounts) {
  const auto lease = robots_.Open("r", 0, kNow_ns);
  ASSERT_TRUE(lease.ok());
  EXPECT_EQ(X(), -1.0);
  EXPECT_TRUE(robots_.Report("r", *lease, Seen(1.0, true)).ok());
  EXPECT_TRUE(robots_.Report("r", *lease, Seen(2.0)).ok());
  EXPECT_EQ(X(), 2.0);
  EXPECT_TRUE(robots_.Find("r")->report.laser);  // the newest there was
  ASSERT_EQ(robots_.List().size(), 1u);
  EXPECT_EQ(robots_.List()[0].first, "r");
  robots_.Close("r", *lease);
  EXPECT_EQ(X(), -1.0);
  EXPECT_TRUE(robots_.List().empty());
  const auto batch = events_.Read(0, 10);
  ASSERT_EQ(batch.events.size(), 3u);
  EXPECT_EQ(std::get<LiveChanged>(batch.events[2]).robot, "r");
}

TEST_F(LiveRobotsTest, ANewerAgentFencesTheOlderOne) {
  const auto old = robots_.Open("r", 0, kNow_ns);
  const auto young = robots_.Open("r", 0, kNow_ns);
  ASSERT_TRUE(old.ok() && young.ok());
  EXPECT_GT(young->epoch, old->epoch);
  EXPECT_TRUE(robots_.Report("r", *young, Seen(2.0)).ok());
  EXPECT_TRUE(absl::IsAborted(robots_.Report("r", *old, Seen(1.0))));
  EXPECT_TRUE(absl::IsAborted(robots_.Open("r", old->epoch, kNow_ns).status()));
  robots_.Close("r", *old);
  EXPECT_EQ(X(), 2.0);
  // Of another robot nobody is fenced.
  const auto other = robots_.Open("r2", 0, kNow_ns);
  EXPECT_TRUE(robots_.Report("r2", *other, Seen(3.0)).ok());
}

TEST_F(LiveRobotsTest, AnAgentThatConnectsAgainTakesOverFromItself) {
  const auto first = robots_.Open("r", 0, kNow_ns);
  EXPECT_TRUE(robots_.Report("r", *first, Seen(1.0)).ok());
  const auto second = robots_.Open("r", first->epoch, kNow_ns);
  ASSERT_TRUE(second.ok());
  EXPECT_EQ(second->epoch, first->epoch);
  EXPECT_TRUE(robots_.Report("r", *second, Seen(2.0)).ok());
  // The stream that died with the link is noticed late.
  EXPECT_TRUE(absl::IsAborted(robots_.Report("r", *first, Seen(1.0))));
  robots_.Close("r", *first);
  EXPECT_EQ(X(), 2.0);
}

TEST_F(LiveRobotsTest, EpochsKeepTheirOrderOverARestart) {
  const std::int64_t old = robots_.Open("r", 0, kNow_ns)->epoch;
  const std::int64_t young = robots_.Open("r", 0, kNow_ns + 1)->epoch;
  LiveRobots restarted(&events_);
  EXPECT_EQ(restarted.Open("r", old, kNow_ns + 100)->epoch, old);
  EXPECT_EQ(restarted.Open("r", young, kNow_ns + 100)->epoch, young);
  EXPECT_TRUE(absl::IsAborted(restarted.Open("r", old, kNow_ns + 100).status()));
  // Nor may they come before one that is newer still.
  LiveRobots once_more(&events_);
  ASSERT_TRUE(once_more.Open("r", 0, kNow_ns + 100).ok());
  EXPECT_TRUE(absl::IsAborted(once_more.Open("r", young, kNow_ns + 101).status()));
  // Nobody gave an epoch of the future: it is an agent that is new here.
  const auto invented = restarted.Open("r", std::int64_t{1} << 62, kNow_ns + 100);
  ASSERT_TRUE(invented.ok());
  EXPECT_LE(invented->epoch, kNow_ns + 100);
  EXPECT_GT(restarted.Open("r", -7, kNow_ns + 100)->epoch, invented->epoch);
}

TEST_F(LiveRobotsTest, KnowsABoundedNumberOfRobots) {
  for (int i = 0; i < 10'000; ++i) {
    const std::string robot = absl::StrCat("r", i);
    const auto lease = robots_.Open(robot, 0, kNow_ns);
    ASSERT_TRUE(lease.ok());
    robots_.Close(robot, *lease);
  }
  int opened = 0;
  while (robots_.Open(absl::StrCat("s", opened), 0, kNow_ns).ok()) ++opened;
  EXPECT_EQ(opened, 4096);
  EXPECT_TRUE(absl::IsResourceExhausted(robots_.Open("one-more", 0, kNow_ns).status()));
  EXPECT_TRUE(robots_.Open("s7", 0, kNow_ns).ok());  // that is known
}

}  // namespace
}  // namespace soundmap::pipeline
