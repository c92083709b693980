#include "sound_map/views.h"

#include <algorithm>
#include <cmath>

namespace soundmap::sound_map {
namespace {

// A view hears a place in this share of its scans at least.
constexpr double kLeastHeard = 0.1;
// More past views are halved.
constexpr double kMaxPast = 32.0;
// Robots whose present views are told apart.
constexpr std::size_t kMaxPresent = 16;

struct Odds {
  double before;
  double evidence_power;
  double heard_power;
  double direct;
  double mirrored;
};
constexpr Odds kInSpace = {-6.82, 1.37, 1.28, -5.48, -2.02};
constexpr Odds kInPlane = {-7.55, 1.26, 0.80, -3.01, 0.0};
constexpr double kLogOddsEcho = 0.36;
constexpr double kLeastEcho = -3.0;
constexpr double kMostEcho = 8.0;
constexpr double kMaxEvidence = 200.0;

bool Heard(const View& view) {
  return view.with_maximum > 0 && view.with_maximum >= kLeastHeard * view.scans;
}

}  // namespace

void Views::Add(const std::string& robot, const Eigen::Vector2d& robot_in_map_m, bool at_maximum,
                double spacing_m) {
  auto view = present.find(robot);
  if (view != present.end() && (view->second.begin_in_map_m - robot_in_map_m).norm() >= spacing_m) {
    End(view->second);
    view->second = {robot_in_map_m};
  } else if (view == present.end()) {
    if (present.size() >= kMaxPresent) {
      End(present.begin()->second);
      present.erase(present.begin());
    }
    view = present.emplace(robot, View{robot_in_map_m}).first;
  }
  ++view->second.scans;
  if (at_maximum) ++view->second.with_maximum;
}

void Views::End(const View& view) {
  if (past >= kMaxPast) {
    past /= 2.0;
    past_heard /= 2.0;
  }
  past += 1.0;
  ended += 1.0;
  if (Heard(view)) past_heard += 1.0;
}

double Views::heard() const {
  return past_heard +
         static_cast<double>(std::count_if(present.begin(), present.end(),
                                           [](const auto& view) { return Heard(view.second); }));
}

double LogOddsByViews(double evidence, const Views& views, const Explained& explained,
                      std::optional<double> echo) {
  const Odds& odds = echo ? kInPlane : kInSpace;
  const double counted = std::min(evidence * views.kept_share(), kMaxEvidence);
  return odds.before + odds.evidence_power * std::log(counted) +
         odds.heard_power * std::log(views.heard() + 1.0) + odds.direct * explained.direct +
         odds.mirrored * explained.mirrored +
         (echo ? kLogOddsEcho * std::clamp(*echo, kLeastEcho, kMostEcho) : 0.0);
}

}  // namespace soundmap::sound_map
