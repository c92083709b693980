#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>

#include "sound_map/registered_source.h"

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
  double ended = 0.0;       // as many past views have there been, with those that are forgotten

  // A robot listened from there, at least `spacing_m` from where its next view begins.
  void Add(const std::string& robot, const Eigen::Vector2d& robot_in_map_m, bool at_maximum,
           double spacing_m);
  double count() const { return past + static_cast<double>(present.size()); }
  double heard() const;
  // Which share of all views is not forgotten.
  double kept_share() const {
    const auto now = static_cast<double>(present.size());
    return ended + now > 0.0 ? (past + now) / (ended + now) : 1.0;
  }

 private:
  void End(const View& view);
};

// That a place is a source, by its evidence e (see sound_sources.h; above 0), the h views that
// heard it, and the shares d and m of its view points from where a stronger place explains it,
// straight on and mirrored. The odds are exp(-6.82 - 5.48 d - 2.02 m) e^1.37 (h + 1)^1.28, by
// logistic regression over 1753 candidates of 133 simulated rooms. Of a place that arrays in a
// plane alone have heard, `echo` says how well the echo of the floor fits it (FloorEcho::AtPlace(),
// -3 to 8 count); the odds are then exp(-7.55 - 3.01 d + 0.36 echo) e^1.26 (h + 1)^0.80, by those
// of the 44 rooms that have such an array. Of the evidence, the share counts that views are kept
// of, and 200 at most.
double LogOddsByViews(double evidence, const Views& views, const Explained& explained,
                      std::optional<double> echo);

}  // namespace soundmap::sound_map
