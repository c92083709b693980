#pragma once

#include <cstdint>
#include <optional>

namespace soundmap::uplink {

// Four stamps: a message's way to the server and its answer's way back. The robot's clock is one
// that nobody sets, the server's may be set.
struct TimeExchange {
  std::int64_t robot_sent_ns = 0;
  std::int64_t server_received_ns = 0;
  std::int64_t server_sent_ns = 0;
  std::int64_t robot_received_ns = 0;
};

// By how much the server's clock differs from the robot's. The ways there and back may take
// different times, so that an exchange tells it up to half of its round trip; and clocks drift, so
// that this grows with time. The best exchange is the one that is known best by now: all grow
// alike, so that one is kept. An exchange that contradicts it says that the server's clock was set,
// and takes its place.
class ClockFilter {
 public:
  // Two crystals of 50 ppm each. A clock that is slewed faster is found as one that was set.
  static constexpr double kDrift_ppm = 100.0;

  // False: the stamps cannot be those of an exchange; nothing changes.
  bool Add(const TimeExchange& exchange);

  struct Estimate {
    std::int64_t server_minus_robot_ns = 0;
    std::int64_t uncertainty_ns = 0;  // it is off by no more
  };
  // None before the first exchange.
  std::optional<Estimate> At(std::int64_t robot_ns) const;

 private:
  std::optional<Estimate> best_;  // as of best_robot_ns_, when its exchange began
  std::int64_t best_robot_ns_ = 0;
};

}  // namespace soundmap::uplink
