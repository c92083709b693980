#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "frames/echo_ripple.h"
#include "frames/octave_bands.h"
#include "sound_map/sound_sources.h"

namespace soundmap::sound_map {

enum class SourceState : std::uint8_t {
  kActive,  // heard when it was last listened to
  kSilent,  // was sure, was listened to since and is not heard
  kGone,    // silent for so long that it counts as removed
};

// Capture time in which a source was heard, with pauses of at most a minute.
struct HeardPeriod {
  frames::TimeNs begin_ns = 0;
  frames::TimeNs end_ns = 0;

  bool operator==(const HeardPeriod&) const = default;
};

// A peak of the sound's power in one scan, where its direction meets a surface.
struct HeardPeak {
  Eigen::Vector3d place_in_map_m = Eigen::Vector3d::Zero();
  frames::BandPowers power_at_1m{};  // single scans scatter, also below 0: take means
  // Of the surface, towards the array, if it is flat there; 0: not known.
  Eigen::Vector3f surface_normal_in_map = Eigen::Vector3f::Zero();
  frames::EchoRipple ripple;  // of arrays in a plane alone

  bool operator==(const HeardPeak&) const = default;
};

// The plane of microphones that lie in one: they hear above and below it alike.
struct ArrayPlane {
  Eigen::Vector3d origin_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();  // unit vector

  bool operator==(const ArrayPlane&) const = default;
};

// Where a robot stood that heard a source, and how loud it was from there.
struct ViewPoint {
  Eigen::Vector2d place_in_map_m = Eigen::Vector2d::Zero();
  bool array_known = false;
  Eigen::Vector3d array_in_map_m = Eigen::Vector3d::Zero();  // of the microphones
  // Normal of the plane of the microphones; 0: they do not lie in one, and tell all directions
  // apart.
  Eigen::Vector3d plane_normal_in_map = Eigen::Vector3d::Zero();
  Eigen::Vector3d surface_normal_sum_in_map = Eigen::Vector3d::Zero();  // of the peaks from there
  std::int64_t level_scans = 0;                                         // with a peak at the source
  std::array<double, frames::kOctaveBands> power_at_1m{};               // sum over these
  std::int64_t spl_scans = 0;  // of these, by calibrated microphones
  // Sum over those, in units of (20 uPa)^2.
  std::array<double, frames::kOctaveBands> squared_pressure_at_1m{};

  // An array that heard the source from there. Of several, one in space says more than one in a
  // plane.
  void AddArray(const Eigen::Vector3d& in_map_m, const std::optional<ArrayPlane>& plane);
  // Whether two places lie in one direction from there, as far as the array can tell.
  bool InOneDirection(const Eigen::Vector3d& place_in_map_m,
                      const Eigen::Vector3d& other_in_map_m) const;
  // Whether the surface at the place mirrors the other one into its direction. Not by arrays in a
  // plane: with all that they cannot tell apart, too many places would.
  bool Mirrors(const Eigen::Vector3d& place_in_map_m, const Eigen::Vector3d& other_in_map_m) const;
  // One scan's peak; with the sound pressure level of a full-scale sine, where it is known.
  void AddLevel(const frames::BandPowers& power, const std::optional<double>& full_scale_spl_db);

  bool operator==(const ViewPoint&) const = default;
};

// Levels in dB by octave band; none in a band that was not measured or where the source does not
// stand out.
using Spectrum = std::array<std::optional<double>, frames::kOctaveBands>;

// Of the bands together; none without any.
std::optional<double> TotalLevel_db(const Spectrum& spectrum_db);

// From which share of its view points (of those whose array is known) a place is heard where
// another one is heard, too: straight on, past and through what hides it there, or by way of the
// surface at the place.
struct Explained {
  double direct = 0.0;
  double mirrored = 0.0;
};

// A sound source as an object that lasts.
struct RegisteredSource {
  SoundSource found;  // as it was last found, but for the id, which stays
  SourceState state = SourceState::kActive;
  Eigen::Matrix3d position_covariance_m2 = Eigen::Matrix3d::Zero();
  frames::TimeNs last_listened_ns = 0;  // newest scan that reached its place, heard or not
  std::vector<std::string> robots;      // that heard it, by name
  std::vector<ViewPoint> view_points;   // thinned out
  std::vector<HeardPeriod> heard;       // oldest first
  // The stronger one that explains it from half of its view points or more; 0: none.
  std::uint64_t explained_by_id = 0;
  // Where it may be instead, as far as all arrays that heard it can tell, being in a plane: a
  // weaker candidate, mirrored. Not part of the register's state, which it follows from.
  std::optional<Eigen::Vector3d> mirror_in_map_m;

  // Whether the arrays that are known to have heard it, one or more, all lie in a plane.
  bool HeardInPlanesAlone() const;

  // Median over the view points of the mean power at 1 m, 0 dB being a full-scale square wave.
  Spectrum Spectrum_db() const;
  // Likewise, in dB re 20 uPa, by the robots with calibrated microphones alone.
  Spectrum SpectrumSpl_db() const;
  Explained ExplainedBy(const Eigen::Vector3d& other_in_map_m) const;

  // A time at which it was heard. The newest periods are kept.
  void AddHeard(frames::TimeNs time_ns);
  void AddRobot(const std::string& robot);
  // It and the other one are one: what is known of when and by whom it was heard.
  void TakeHistory(const RegisteredSource& from);

  bool operator==(const RegisteredSource&) const = default;
};

// Whether their levels agree in the octave bands that both have; not without such bands.
bool SoundAlike(const RegisteredSource& a, const RegisteredSource& b);

}  // namespace soundmap::sound_map
