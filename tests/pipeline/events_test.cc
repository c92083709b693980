#include "pipeline/events.h"

#include <gtest/gtest.h>

namespace soundmap::pipeline {
namespace {

std::uint64_t IdOf(const Event& event) { return std::get<SourceRemoved>(event).id; }

TEST(EventRing, IsReadInOrderAndInPages) {
  EventRing ring(/*capacity=*/10);
  for (std::uint64_t id = 0; id < 5; ++id) ring.Publish(SourceRemoved{kMainBand, id});
  EventRing::Batch batch = ring.Read(0, 3);
  ASSERT_EQ(batch.events.size(), 3u);
  EXPECT_EQ(batch.next, 3);
  EXPECT_FALSE(batch.lost);
  batch = ring.Read(batch.next, 3);
  ASSERT_EQ(batch.events.size(), 2u);
  EXPECT_EQ(IdOf(batch.events[0]), 3u);
  EXPECT_TRUE(ring.Read(5, 3).events.empty());
}

TEST(EventRing, TellsASlowReaderWhatItLost) {
  EventRing ring(/*capacity=*/4);
  for (std::uint64_t id = 0; id < 10; ++id) ring.Publish(SourceRemoved{kMainBand, id});
  const EventRing::Batch batch = ring.Read(2, 100);
  EXPECT_TRUE(batch.lost);
  ASSERT_EQ(batch.events.size(), 4u);
  EXPECT_EQ(IdOf(batch.events.front()), 6u);
  EXPECT_TRUE(ring.Read(11, 1).lost);  // a position that never was
  EXPECT_FALSE(ring.Read(6, 1).lost);
}

TEST(EventRing, WakesUntilUnsubscribed) {
  EventRing ring;
  int wakes = 0;
  const int subscription = ring.Subscribe([&wakes] { ++wakes; });
  ring.Publish(SourceRemoved{});
  ring.Publish(SourceRemoved{});
  ring.Unsubscribe(subscription);
  ring.Publish(SourceRemoved{});
  EXPECT_EQ(wakes, 2);
}

}  // namespace
}  // namespace soundmap::pipeline
