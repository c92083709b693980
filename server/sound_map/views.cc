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

constexpr double kLogOddsBefore = -6.82;
constexpr double kEvidencePower = 1.37;
constexpr double kHeardPower = 1.28;
constexpr double kLogOddsDirect = -5.48;
constexpr double kLogOddsMirrored = -2.02;
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

double LogOddsByViews(double evidence, const Views& views, const Explained& explained) {
  const double counted = std::min(evidence * views.kept_share(), kMaxEvidence);
  return kLogOddsBefore + kEvidencePower * std::log(counted) +
         kHeardPower * std::log(views.heard() + 1.0) + kLogOddsDirect * explained.direct +
         kLogOddsMirrored * explained.mirrored;
}

}  // namespace soundmap::sound_map
