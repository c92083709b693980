#include "uplink/clock_filter.h"

#include <cmath>
#include <cstdlib>

namespace soundmap::uplink {
namespace {

// Beyond are no times: 73 years after the robot was switched on, 2116. Offsets of those within, and
// differences of two offsets, fit into 64 bits.
constexpr std::int64_t kMaxRobotTime_ns = std::int64_t{1} << 61;
constexpr std::int64_t kMaxServerTime_ns = std::int64_t{1} << 62;

std::int64_t DriftIn(std::int64_t time_ns) {
  return static_cast<std::int64_t>(
      std::ceil(1e-6 * ClockFilter::kDrift_ppm * std::abs(static_cast<double>(time_ns))));
}

}  // namespace

bool ClockFilter::Add(const TimeExchange& exchange) {
  const auto& [robot_sent_ns, server_received_ns, server_sent_ns, robot_received_ns] = exchange;
  if (robot_sent_ns < 0 || robot_received_ns < robot_sent_ns ||
      robot_received_ns > kMaxRobotTime_ns || server_received_ns < 0 ||
      server_sent_ns < server_received_ns || server_sent_ns > kMaxServerTime_ns) {
    return false;
  }
  const std::int64_t at_server_ns = server_sent_ns - server_received_ns;
  const std::int64_t round_trip_ns = robot_received_ns - robot_sent_ns - at_server_ns;
  if (round_trip_ns < 0) return false;
  // The server received it between 0 and the round trip after it was sent.
  const Estimate taken{server_received_ns - robot_sent_ns - round_trip_ns / 2,
                       round_trip_ns - round_trip_ns / 2 + DriftIn(at_server_ns)};
  const std::optional<Estimate> known = At(robot_sent_ns);
  const bool contradicts =
      known && std::abs(taken.server_minus_robot_ns - known->server_minus_robot_ns) >
                   taken.uncertainty_ns + known->uncertainty_ns;
  if (!known || contradicts || taken.uncertainty_ns <= known->uncertainty_ns) {
    best_ = taken;
    best_robot_ns_ = robot_sent_ns;
  }
  return true;
}

std::optional<ClockFilter::Estimate> ClockFilter::At(std::int64_t robot_ns) const {
  if (!best_) return std::nullopt;
  return Estimate{best_->server_minus_robot_ns,
                  best_->uncertainty_ns + DriftIn(robot_ns - best_robot_ns_)};
}

}  // namespace soundmap::uplink
