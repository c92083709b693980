#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sound_map/config.h"
#include "sound_map/evidence.h"
#include "sound_map/floor_echo.h"
#include "sound_map/mirrors.h"
#include "sound_map/place_index.h"
#include "sound_map/registered_source.h"
#include "sound_map/views.h"

namespace soundmap::sound_map {

struct SourceEvent {
  enum class Kind { kAppeared, kFellSilent, kActiveAgain, kVanished, kMerged, kMoved };
  Kind kind = Kind::kAppeared;
  frames::TimeNs time_ns = 0;  // t_k of the scan at which it was noticed
  RegisteredSource source;     // after the event
  // kMerged: the one that it is now part of; kMoved: what the place where it is now was called.
  std::uint64_t other_id = 0;
  Eigen::Vector3d from_in_map_m = Eigen::Vector3d::Zero();  // kMoved: where it was
};

// The sound sources of a map as objects: what FindSoundSources() finds at one instant is joined to
// what was found before. A function of the scans in their order alone: call Observe() for each, and
// Update() whenever due(), with what is then found in the map. One thread at a time; copies are
// independent.
//
// A found source is the registered one nearest to it, within separation_m; each takes part once,
// nearest pairs first. One that is left over is new. A registered source that is not found any more
// is merged into one that was found within separation_m of it (within masking_radius_m, if it is
// active); kept, if it was sure for kSureScans from two view points; and forgotten otherwise.
//
// A ghost is heard from some places and not from others, a source from wherever it is in view: how
// probable a source is says LogOddsByViews(), with the views since it was first found, each
// view_point_spacing_m long. A maximum within 0.2 m of a source is at it.
//
// A source that furniture hides is heard through it and past it, and its direction then ends on
// what hides it; a wall mirrors a source that the scan itself does not show. So what a stronger
// place explains is the less probable (RegisteredSource::ExplainedBy()). A place that is explained
// from half of its view points explains nothing in turn.
//
// An array in a plane hears a source and its mirror image alike. Of two places, one of which is
// heard as the image of the other one (Mirrors::Has), the one that the echo of the floor fits is
// the source (FloorEcho); where it does not tell, the one with more evidence. It is as probable as
// what was heard at either makes it. The other one is kept as improbable, and told as
// mirror_in_map_m of the source as long as the echo does not tell and the source, too, is heard
// with its image in half of the scans: an array in space and one in another plane tell them apart,
// too. It is kept for a source that fell silent, since silence tells nothing. A place whose image
// fits the echo where nothing was found is reported there.
//
// A scan listens to a source if it has an end point within core_radius_m of it, and hears it if one
// of these supports a source. Silence counts only near where robots have heard the source before:
// the share of such scans that heard it while active, against that which hear something at a silent
// place, gives the log-odds that it is on, bounded so that a long past is soon unlearnt. A silent
// source has moved to where one sounds alike that is heard from where it was, and was found long
// after it was heard for the last time. Scans of the past, from recordings that come late, count in
// the history alone.
class SourceRegister {
 public:
  struct Observation {
    std::string robot;
    Eigen::Vector2d robot_in_map_m = Eigen::Vector2d::Zero();
    const EvidenceScan* evidence = nullptr;
    const std::vector<HeardPeak>* peaks = nullptr;  // may be null: none
    std::optional<ArrayPlane> array_plane;
    // Sound pressure level of a full-scale sine at the microphones, in dB re 20 uPa.
    std::optional<double> full_scale_spl_db;
    std::optional<Eigen::Vector3d> array_in_map_m;  // none: not known
  };

  explicit SourceRegister(const SoundMapConfig& config);

  void Observe(const Observation& scan);
  // Whether some robot's scans since the last Update() are enough for another one.
  bool due() const;
  // Whether there was a scan since the last Update().
  bool pending() const { return !state_.scans.empty(); }
  std::vector<SourceEvent> Update(const std::vector<SoundSource>& found);

  // The most probable first, then by id.
  std::vector<RegisteredSource> Sources() const;

  // What is known of one place.
  struct Track {
    RegisteredSource source;
    frames::TimeNs judged_ns = 0;        // newest scan that `log_odds_on` is of
    double log_odds_on = 0.0;            // that it emits sound now
    frames::TimeNs found_ns = 0;         // t_k of the scan after which it was first found
    frames::TimeNs active_until_ns = 0;  // newest scan that heard it while it was surely on
    bool left = false;                   // the source has moved away: a place, not a source
    double listened_scans = 0.0;         // while active; old ones are forgotten
    double heard_scans = 0.0;            //   of these
    std::int64_t sure_scans = 0;         // that listened to it since it became probable
    double silent_s = 0.0;               // that it was listened to since it fell silent
    bool announced = false;              // its appearance was an event
    std::int64_t position_scans = 0;     // that `scatter_m2` is of
    Eigen::Vector3d mean_in_map_m = Eigen::Vector3d::Zero();
    Eigen::Matrix3d scatter_m2 = Eigen::Matrix3d::Zero();
    Views views;
    Mirrors mirrors;
    FloorEcho echo;
  };
  // All that the future depends on.
  struct State {
    std::vector<Track> tracks;
    std::map<std::string, int> scans;  // of each robot since the last Update()
    frames::TimeNs last_ns = 0;        // t_k of the last scan
  };
  const State& state() const { return state_; }
  void Restore(State state);

 private:
  struct Hit {
    int end_points = 0;
    int supporting = 0;
    const HeardPeak* peak = nullptr;                         // nearest to the source
    Eigen::Vector3d sum_in_map_m = Eigen::Vector3d::Zero();  // of the supporting ones
    bool at_maximum = false;
  };

  bool IsSure(const Track& track) const;
  void Listen(Track& track, const Hit& hit, const Observation& scan);
  void JudgeFound(const std::vector<bool>& is_found);
  void RuleOutMirrors();
  bool RulesOut(const Track& track, const Track& mirror) const;
  // By its echo, what is heard there is at its image.
  static bool IsImage(const Track& track);
  RegisteredSource Describe(const Track& track) const;
  // That a source is at the place of `track`, if what `heard` has heard comes from there.
  double ProbabilityOf(const Track& track, const Track& heard, const Explained& explained) const;
  static double StrengthOf(const Track& track);
  void JudgeActivity(Track& track, bool heard, frames::TimeNs stamp_ns);
  void MergeInto(Track& into, Track& from, std::vector<SourceEvent>& events);
  void Join(const std::vector<SoundSource>& found, std::vector<SourceEvent>& events);
  void Move(std::vector<SourceEvent>& events);
  void ChangeStates(std::vector<SourceEvent>& events);
  void Forget();
  SourceEvent EventOf(SourceEvent::Kind kind, const Track& track) const;
  void IndexPlaces();

  SoundMapConfig config_;
  State state_;
  PlaceIndex places_;         // of the tracks
  std::vector<Hit> hits_;     // by track, empty between scans
  std::vector<int> touched_;  // tracks with a hit
};

}  // namespace soundmap::sound_map
