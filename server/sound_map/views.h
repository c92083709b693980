#pragma once

#include <Eigen/Core>
#include <map>
#include <string>

namespace soundmap::sound_map {

// How often a robot listened to a place from about where it stood when it began.
struct View {
  Eigen::Vector2d begin_in_map_m = Eigen::Vector2d::Zero();
  int scans = 0;
  int with_maximum = 0;  // of these, with a local maximum of the power at the place

  bool operator==(const View&) const = default;
};

// From how many views robots listened to one place, and from how many of them they heard it. A
// robot's view begins anew when it has moved on; a view hears the place if a tenth of its scans
// have a maximum there. Old views are forgotten, so that what a small share of the views hears does
// not become sure with time.
struct Views {
  std::map<std::string, View> present;  // by robot
  double past = 0.0;
  double past_heard = 0.0;  // of these

  // A robot listened from there, at least `spacing_m` from where its next view begins.
  void Add(const std::string& robot, const Eigen::Vector2d& robot_in_map_m, bool at_maximum,
           double spacing_m);
  double count() const { return past + static_cast<double>(present.size()); }
  double heard() const;

 private:
  void End(const View& view);
};

// That a place is a source, by its evidence (see sound_sources.h; above 0) and its views: with h of
// n views, the odds are exp(-3.9) e^0.36 (h + 1)^2.94 / (n + 1)^0.53. By logistic regression over
// 492 candidates of 53 simulated rooms. e counts up to 1000, for the same reason as views are
// forgotten.
double LogOddsByViews(double evidence, const Views& views);

}  // namespace soundmap::sound_map
