#include "sound_map/source_register.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <tuple>
#include <utility>

namespace soundmap::sound_map {
namespace {

// Some two seconds of one robot.
constexpr int kUpdateScans = 16;

// A source is announced at this probability, and sure after so many scans that listened to it while
// it was very probable.
constexpr double kAnnounceProbability = 0.5;
constexpr double kSureProbability = 0.9;
constexpr std::int64_t kSureScans = 80;
constexpr std::size_t kSureViewPoints = 2;

// Scans of one robot follow each other closely and hear the same: so many of them count as one.
constexpr double kRepetition = 8.0;
// Bound of the log-odds that a source is on, and where they switch its state.
constexpr double kMaxLogOddsOn = 4.0;
constexpr double kSwitchLogOdds = 2.0;
// The share of scans that hear a source is taken from at most so many.
constexpr double kShareScans = 4096.0;
constexpr double kMaxShare = 0.95;
// Scans of several robots come out of order by less.
constexpr frames::TimeNs kLate_ns = 10'000'000'000;
// A longer pause between two scans was spent elsewhere.
constexpr double kMaxPause_s = 1.0;

constexpr std::size_t kMaxViewPoints = 64;
constexpr std::size_t kMaxGone = 256;

// A scan has a maximum at a source that is so near.
constexpr double kAtMaximum_m = 0.2;
// A place that is explained from this share of its view points is told as such; one that lies in
// the direction of another from so many explains no other.
constexpr double kExplained = 0.5;
// That the weaker of two mirrored places is the source.
constexpr double kMirrorProbability = 0.3;
// The echo of the floor tells which of the two it is from so many standard deviations on, also
// where fewer of the scans that heard the one heard the other.
constexpr double kEchoSigmas = 3.0;
constexpr double kEchoShare = 0.2;
// A source that was announced is not ruled out by one that is only just stronger.
constexpr double kAnnouncedWeight = 1.5;

// A source that has moved: how far at most, and how long after it was heard for the last time it is
// found again at least. What is there all the time is found in some seconds.
constexpr double kMaxMove_m = 10.0;
constexpr frames::TimeNs kMinMovePause_ns = 60'000'000'000;

// Whether a robot that heard the one was where the other is heard.
bool ShareAViewPoint(const RegisteredSource& a, const RegisteredSource& b, double spacing_m) {
  for (const ViewPoint& of_a : a.view_points) {
    for (const ViewPoint& of_b : b.view_points) {
      if ((of_a.place_in_map_m - of_b.place_in_map_m).norm() < spacing_m) return true;
    }
  }
  return false;
}

}  // namespace

SourceRegister::SourceRegister(const SoundMapConfig& config)
    : config_(config), places_(config.sources.core_radius_m, config.voxel_size_m) {}

void SourceRegister::Restore(State state) {
  state_ = std::move(state);
  IndexPlaces();
}

bool SourceRegister::due() const {
  return std::any_of(state_.scans.begin(), state_.scans.end(),
                     [](const auto& robot) { return robot.second >= kUpdateScans; });
}

bool SourceRegister::IsSure(const Track& track) const {
  return track.sure_scans >= kSureScans && track.source.view_points.size() >= kSureViewPoints;
}

void SourceRegister::Observe(const Observation& scan) {
  ++state_.scans[scan.robot];
  state_.last_ns = scan.evidence->stamp_ns;
  for (const EndPoint& end_point : scan.evidence->end_points) {
    if (!places_.MayBeNear(end_point.key)) continue;
    const std::optional<int> nearest = places_.Nearest(end_point.key);
    if (!nearest) continue;
    Hit& hit = hits_[*nearest];
    if (hit.end_points++ == 0) touched_.push_back(*nearest);
    if (end_point.likelihood > 0.5f) {
      ++hit.supporting;
      hit.sum_in_map_m += geometry::PointFromKey(end_point.key, config_.voxel_size_m);
    }
  }
  if (scan.peaks != nullptr) {
    for (const HeardPeak& peak : *scan.peaks) {
      int nearest = -1;
      double nearest_m2 = config_.sources.core_radius_m * config_.sources.core_radius_m;
      for (const int i : touched_) {
        const double distance_m2 =
            (state_.tracks[i].source.found.position_in_map_m - peak.place_in_map_m).squaredNorm();
        if (distance_m2 > nearest_m2) continue;
        nearest = i;
        nearest_m2 = distance_m2;
      }
      // Peaks come strongest first.
      if (nearest >= 0 && hits_[nearest].peak == nullptr) hits_[nearest].peak = &peak;
    }
  }
  for (const geometry::VoxelKey& key : scan.evidence->maxima) {
    const Eigen::Vector3d maximum = geometry::PointFromKey(key, config_.voxel_size_m);
    for (const int i : touched_) {
      const Eigen::Vector3d& place = state_.tracks[i].source.found.position_in_map_m;
      if ((place - maximum).squaredNorm() < kAtMaximum_m * kAtMaximum_m) {
        hits_[i].at_maximum = true;
      }
    }
  }
  std::vector<HeardPlace> heard;
  for (const int i : touched_) {
    Track& track = state_.tracks[i];
    if (hits_[i].supporting == 0) continue;
    heard.push_back({track.source.found.id, track.source.found.position_in_map_m, &track.mirrors});
    if (scan.array_plane && scan.peaks != nullptr) {
      track.echo.Add(*scan.array_plane, track.source.found.position_in_map_m, *scan.peaks);
    }
  }
  CountMirrors(scan.array_plane, heard);
  for (const int i : touched_) Listen(state_.tracks[i], std::exchange(hits_[i], {}), scan);
  touched_.clear();
}

void SourceRegister::Listen(Track& track, const Hit& hit, const Observation& scan) {
  const frames::TimeNs stamp_ns = scan.evidence->stamp_ns;
  RegisteredSource& source = track.source;
  if (!scan.evidence->maxima.empty() && source.state == SourceState::kActive) {
    track.views.Add(scan.robot, scan.robot_in_map_m, hit.at_maximum,
                    config_.sources.view_point_spacing_m);
  }
  const bool heard = hit.supporting > 0;
  const double pause_s =
      std::clamp(frames::SecondsFromNs(stamp_ns - source.last_listened_ns), 0.0, kMaxPause_s);
  source.last_listened_ns = std::max(source.last_listened_ns, stamp_ns);
  if (source.found.probability >= kSureProbability) ++track.sure_scans;

  const auto distance_m = [&](const ViewPoint& view_point) {
    return (view_point.place_in_map_m - scan.robot_in_map_m).norm();
  };
  auto view_point = std::min_element(
      source.view_points.begin(), source.view_points.end(),
      [&](const ViewPoint& a, const ViewPoint& b) { return distance_m(a) < distance_m(b); });
  if (view_point == source.view_points.end() ||
      distance_m(*view_point) >= config_.sources.view_point_spacing_m) {
    if (!heard) return;
    if (source.view_points.size() < kMaxViewPoints) {
      view_point = source.view_points.insert(source.view_points.end(), {scan.robot_in_map_m});
    }
  }
  if (source.state != SourceState::kActive) track.silent_s += pause_s;
  JudgeActivity(track, heard, stamp_ns);
  if (!heard) return;

  source.AddHeard(stamp_ns);
  source.AddRobot(scan.robot);
  if (scan.array_in_map_m) view_point->AddArray(*scan.array_in_map_m, scan.array_plane);
  if (hit.peak != nullptr) {
    view_point->AddLevel(hit.peak->power_at_1m, scan.full_scale_spl_db);
    view_point->surface_normal_sum_in_map += hit.peak->surface_normal_in_map.cast<double>();
  }
  // Welford's mean and scatter of the places where single scans heard it.
  const Eigen::Vector3d place = hit.sum_in_map_m / hit.supporting;
  ++track.position_scans;
  const Eigen::Vector3d off = place - track.mean_in_map_m;
  track.mean_in_map_m += off / static_cast<double>(track.position_scans);
  track.scatter_m2 += off * (place - track.mean_in_map_m).transpose();
  // Scans from one view point err alike. No position is better known than a voxel is wide.
  const double views = static_cast<double>(std::max<std::size_t>(source.view_points.size(), 1));
  const double voxel_m2 = config_.voxel_size_m * config_.voxel_size_m / 12.0;
  const Eigen::Matrix3d scatter_m2 = 0.5 * (track.scatter_m2 + track.scatter_m2.transpose());
  source.position_covariance_m2 = scatter_m2 / (static_cast<double>(track.position_scans) * views) +
                                  voxel_m2 * Eigen::Matrix3d::Identity();
}

bool SourceRegister::RulesOut(const Track& track, const Track& mirror) const {
  const bool is_image = IsImage(mirror);
  if (is_image != IsImage(track)) {
    const Track& image = is_image ? mirror : track;
    const Track& other = is_image ? track : mirror;
    const double apart_m =
        (image.echo.ImagePlace_in_map_m() - other.source.found.position_in_map_m).norm();
    if (apart_m < config_.sources.separation_m) return is_image;
  }
  const double echo = track.echo.Against(mirror.echo);
  if (std::abs(echo) >= kEchoSigmas && mirror.mirrors.Has(track.source.found.id, kEchoShare)) {
    return echo > 0.0;
  }
  if (!mirror.mirrors.Has(track.source.found.id)) return false;
  return std::pair(StrengthOf(mirror), mirror.source.found.id) <
         std::pair(StrengthOf(track), track.source.found.id);
}

bool SourceRegister::IsImage(const Track& track) {
  // What an array in space hears at the place speaks for the place.
  return 2.0 * track.echo.scans >= track.mirrors.scans && track.echo.image_in_map_m.z() > 0.0 &&
         track.echo.AgainstImage() <= -kEchoSigmas;
}

double SourceRegister::StrengthOf(const Track& track) {
  return track.source.found.evidence * (track.announced ? kAnnouncedWeight : 1.0);
}

void SourceRegister::JudgeFound(const std::vector<bool>& is_found) {
  std::vector<Track>& tracks = state_.tracks;
  std::vector<std::size_t> strongest_first;
  std::vector<bool> ruled_out(tracks.size(), false);  // these come last: they explain no source
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    if (tracks[t].source.state != SourceState::kActive) continue;
    strongest_first.push_back(t);
    ruled_out[t] = std::any_of(tracks.begin(), tracks.end(), [&](const Track& other) {
      return other.source.state == SourceState::kActive && RulesOut(other, tracks[t]);
    });
  }
  std::sort(strongest_first.begin(), strongest_first.end(), [&](std::size_t a, std::size_t b) {
    const auto rank = [&](std::size_t t) {
      return std::tuple(ruled_out[t], -StrengthOf(tracks[t]), tracks[t].source.found.id);
    };
    return rank(a) < rank(b);
  });
  std::vector<const RegisteredSource*> unexplained;
  for (const std::size_t t : strongest_first) {
    RegisteredSource& source = tracks[t].source;
    Explained most;
    double largest = 0.0;
    source.explained_by_id = 0;
    for (const RegisteredSource* stronger : unexplained) {
      const Explained explained = source.ExplainedBy(stronger->found.position_in_map_m);
      most.direct = std::max(most.direct, explained.direct);
      most.mirrored = std::max(most.mirrored, explained.mirrored);
      const double share = std::max(explained.direct, explained.mirrored);
      if (share < kExplained || share <= largest) continue;
      largest = share;
      source.explained_by_id = stronger->found.id;
    }
    if (most.direct < kExplained) unexplained.push_back(&source);
    if (!is_found[t]) continue;
    source.found.probability = ProbabilityOf(tracks[t], tracks[t], most);
    // What was heard at the images that it rules out was heard from here.
    for (const Track& image : tracks) {
      if (image.source.state != SourceState::kActive || !RulesOut(tracks[t], image)) continue;
      source.found.probability =
          std::max(source.found.probability, ProbabilityOf(tracks[t], image, most));
    }
    if (source.found.probability < kAnnounceProbability) tracks[t].sure_scans = 0;
  }
}

void SourceRegister::RuleOutMirrors() {
  std::set<std::uint64_t> ids;
  for (const Track& track : state_.tracks) ids.insert(track.source.found.id);
  for (Track& track : state_.tracks) {
    std::erase_if(track.mirrors.with,
                  [&](const auto& mirror) { return ids.count(mirror.first) == 0; });
    if (track.source.state != SourceState::kActive) continue;
    if (std::any_of(state_.tracks.begin(), state_.tracks.end(),
                    [&](const Track& other) { return RulesOut(other, track); })) {
      double& probability = track.source.found.probability;
      probability = std::min(probability, kMirrorProbability);
    }
  }
}

RegisteredSource SourceRegister::Describe(const Track& track) const {
  RegisteredSource source = track.source;
  if (IsImage(track)) {
    source.found.position_in_map_m = track.echo.ImagePlace_in_map_m();
    return source;
  }
  if (track.mirrors.with.empty()) return source;
  const Track* strongest = nullptr;
  for (const Track& mirror : state_.tracks) {
    if (mirror.source.found.probability > kMirrorProbability || !RulesOut(track, mirror) ||
        !track.mirrors.Has(mirror.source.found.id) ||
        std::abs(track.echo.Against(mirror.echo)) >= kEchoSigmas) {
      continue;
    }
    if (strongest == nullptr || mirror.source.found.evidence > strongest->source.found.evidence) {
      strongest = &mirror;
    }
  }
  if (strongest != nullptr) source.mirror_in_map_m = strongest->source.found.position_in_map_m;
  return source;
}

double SourceRegister::ProbabilityOf(const Track& track, const Track& heard,
                                     const Explained& explained) const {
  const SoundSource& found = heard.source.found;
  if (!config_.sources.judge_by_views || heard.views.count() == 0.0 || !(found.evidence > 0.0)) {
    return found.probability;
  }
  std::optional<double> echo;
  if (track.source.HeardInPlanesAlone()) echo = track.echo.AtPlace();
  return ProbabilityFromLogOdds(LogOddsByViews(found.evidence, heard.views, explained, echo));
}

void SourceRegister::JudgeActivity(Track& track, bool heard, frames::TimeNs stamp_ns) {
  if (stamp_ns < track.judged_ns - kLate_ns) return;
  track.judged_ns = std::max(track.judged_ns, stamp_ns);
  if (track.source.state == SourceState::kActive) {
    if (track.listened_scans >= kShareScans) {
      track.listened_scans /= 2.0;
      track.heard_scans /= 2.0;
    }
    track.listened_scans += 1.0;
    if (heard) track.heard_scans += 1.0;
  }
  const double background = config_.sources.background_share;
  const double share = std::clamp((track.heard_scans + 1.0) / (track.listened_scans + 2.0),
                                  std::min(2.0 * background, kMaxShare), kMaxShare);
  const double change =
      heard ? std::log(share / background) : std::log((1.0 - share) / (1.0 - background));
  track.log_odds_on =
      std::clamp(track.log_odds_on + change / kRepetition, -kMaxLogOddsOn, kMaxLogOddsOn);
  if (heard && track.log_odds_on >= kSwitchLogOdds) {
    track.active_until_ns = std::max(track.active_until_ns, stamp_ns);
  }
}

std::vector<SourceEvent> SourceRegister::Update(const std::vector<SoundSource>& found) {
  std::vector<SourceEvent> events;
  Join(found, events);
  RuleOutMirrors();
  ChangeStates(events);
  Move(events);
  Forget();
  state_.scans.clear();
  IndexPlaces();
  return events;
}

SourceEvent SourceRegister::EventOf(SourceEvent::Kind kind, const Track& track) const {
  return {kind, state_.last_ns, Describe(track)};
}

void SourceRegister::MergeInto(Track& into, Track& from, std::vector<SourceEvent>& events) {
  // The name of the one that was announced, and of these the one that was heard first.
  const auto rank = [](const Track& track) {
    return std::tuple(!track.announced, track.source.found.first_heard_ns, track.source.found.id);
  };
  if (rank(from) < rank(into)) {
    std::swap(from.source.found.id, into.source.found.id);
    std::swap(from.announced, into.announced);
  }
  into.source.TakeHistory(from.source);
  for (Track& track : state_.tracks) {
    track.mirrors.Merge(from.source.found.id, into.source.found.id);
    if (track.source.explained_by_id == from.source.found.id) {
      track.source.explained_by_id = into.source.found.id;
    }
  }
  if (!from.announced) return;
  events.push_back(EventOf(SourceEvent::Kind::kMerged, from));
  events.back().other_id = into.source.found.id;
}

void SourceRegister::Join(const std::vector<SoundSource>& found, std::vector<SourceEvent>& events) {
  std::vector<Track>& tracks = state_.tracks;
  const double separation_m = config_.sources.separation_m;
  const auto distance_m = [&](const Track& track, const SoundSource& source) {
    return (track.source.found.position_in_map_m - source.position_in_map_m).norm();
  };
  std::vector<std::tuple<double, std::uint64_t, std::size_t, std::size_t>> pairs;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    // A silent one stays where it is, and what is beside it is another.
    const double reach_m = tracks[t].source.state == SourceState::kActive
                               ? separation_m
                               : config_.sources.core_radius_m;
    for (std::size_t f = 0; f < found.size(); ++f) {
      const double pair_m = distance_m(tracks[t], found[f]);
      if (pair_m <= reach_m) pairs.emplace_back(pair_m, tracks[t].source.found.id, t, f);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  std::vector<bool> is_found(tracks.size(), false);
  std::vector<bool> is_known(found.size(), false);
  for (const auto& [pair_m, id, t, f] : pairs) {
    if (is_found[t] || is_known[f]) continue;
    is_found[t] = is_known[f] = true;
    // What is not heard is not found anew: its voxels only have not been unlearnt yet.
    SoundSource& known = tracks[t].source.found;
    if (tracks[t].source.state != SourceState::kActive) continue;
    const SoundSource before = std::exchange(known, found[f]);
    known.id = before.id;
    known.first_heard_ns = std::min(known.first_heard_ns, before.first_heard_ns);
    known.last_heard_ns = std::max(known.last_heard_ns, before.last_heard_ns);
  }
  JudgeFound(is_found);

  std::vector<bool> is_kept = is_found;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    if (is_found[t]) continue;
    Track& track = tracks[t];
    int nearest = -1;
    // What sounds there is explained by a source that masks it; what is silent stays a place of its
    // own.
    double nearest_m = track.source.state == SourceState::kActive ? config_.sources.masking_radius_m
                                                                  : separation_m;
    for (std::size_t u = 0; u < tracks.size(); ++u) {
      const double apart_m = distance_m(tracks[u], track.source.found);
      if (!is_found[u] || apart_m > nearest_m) continue;
      nearest = static_cast<int>(u);
      nearest_m = apart_m;
    }
    if (nearest >= 0) {
      MergeInto(tracks[nearest], track, events);
    } else if (IsSure(track) || std::any_of(tracks.begin(), tracks.end(), [&](const Track& other) {
                 return other.source.state != SourceState::kActive && !other.left &&
                        RulesOut(other, track);
               })) {
      is_kept[t] = true;
    } else if (track.announced) {
      track.source.state = SourceState::kGone;
      events.push_back(EventOf(SourceEvent::Kind::kVanished, track));
    }
  }
  std::set<std::uint64_t> ids;
  std::vector<Track> kept;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    if (!is_kept[t]) continue;
    ids.insert(tracks[t].source.found.id);
    kept.push_back(std::move(tracks[t]));
  }
  tracks = std::move(kept);

  for (std::size_t f = 0; f < found.size(); ++f) {
    if (is_known[f]) continue;
    Track track;
    track.source.found = found[f];
    while (!ids.insert(track.source.found.id).second) ++track.source.found.id;
    track.source.last_listened_ns = track.judged_ns = found[f].last_heard_ns;
    track.log_odds_on = kMaxLogOddsOn;
    track.found_ns = track.active_until_ns = state_.last_ns;
    track.source.AddHeard(found[f].last_heard_ns);
    tracks.push_back(std::move(track));
  }
}

void SourceRegister::ChangeStates(std::vector<SourceEvent>& events) {
  for (Track& track : state_.tracks) {
    SourceState& state = track.source.state;
    if (track.left && track.log_odds_on >= kSwitchLogOdds) {
      // Something else sounds here now.
      track.left = false;
      state = SourceState::kActive;
    }
    if (!track.left && !track.announced && track.source.found.probability >= kAnnounceProbability) {
      track.announced = true;
      events.push_back(EventOf(SourceEvent::Kind::kAppeared, track));
    }
    if (state == SourceState::kActive && track.announced && track.log_odds_on <= -kSwitchLogOdds) {
      state = SourceState::kSilent;
      track.silent_s = 0.0;
      events.push_back(EventOf(SourceEvent::Kind::kFellSilent, track));
    } else if (state != SourceState::kActive && track.log_odds_on >= kSwitchLogOdds) {
      state = SourceState::kActive;
      events.push_back(EventOf(SourceEvent::Kind::kActiveAgain, track));
    } else if (state == SourceState::kSilent && track.silent_s >= config_.sources.gone_after_s) {
      state = SourceState::kGone;
      if (!track.left) events.push_back(EventOf(SourceEvent::Kind::kVanished, track));
    }
  }
}

void SourceRegister::Move(std::vector<SourceEvent>& events) {
  std::vector<Track>& tracks = state_.tracks;
  std::vector<std::tuple<double, std::uint64_t, std::size_t, std::size_t>> pairs;
  for (std::size_t from = 0; from < tracks.size(); ++from) {
    const Track& old = tracks[from];
    if (old.left || old.source.state == SourceState::kActive || !IsSure(old)) continue;
    for (std::size_t to = 0; to < tracks.size(); ++to) {
      const Track& present = tracks[to];
      if (!present.announced || present.source.state != SourceState::kActive || !IsSure(present) ||
          present.found_ns < old.active_until_ns + kMinMovePause_ns) {
        continue;
      }
      const double moved_m =
          (present.source.found.position_in_map_m - old.source.found.position_in_map_m).norm();
      if (moved_m > kMaxMove_m ||
          !ShareAViewPoint(old.source, present.source, config_.sources.view_point_spacing_m) ||
          !SoundAlike(old.source, present.source)) {
        continue;
      }
      pairs.emplace_back(moved_m, old.source.found.id, from, to);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  std::set<std::size_t> has_moved;
  for (const auto& [moved_m, id, from, to] : pairs) {
    Track& old = tracks[from];
    Track& present = tracks[to];
    if (old.left || !has_moved.insert(to).second) continue;
    for (Track& track : tracks) {
      track.mirrors.Swap(old.source.found.id, present.source.found.id);
      if (track.source.explained_by_id == present.source.found.id) {
        track.source.explained_by_id = old.source.found.id;  // which it is called now
      }
    }
    std::swap(old.source.found.id, present.source.found.id);
    present.source.TakeHistory(old.source);
    old.left = true;
    old.announced = false;
    old.source.heard.clear();
    old.source.robots.clear();
    events.push_back(EventOf(SourceEvent::Kind::kMoved, present));
    events.back().other_id = old.source.found.id;
    events.back().from_in_map_m = old.source.found.position_in_map_m;
  }
}

void SourceRegister::Forget() {
  std::vector<Track>& tracks = state_.tracks;
  const frames::TimeNs oldest_ns =
      state_.last_ns - frames::NsFromSeconds(config_.sources.history_days * 86400.0);
  std::vector<frames::TimeNs> gone_ns;
  for (Track& track : tracks) {
    std::erase_if(track.source.heard,
                  [&](const HeardPeriod& period) { return period.end_ns < oldest_ns; });
    if (track.source.state == SourceState::kGone)
      gone_ns.push_back(track.source.found.last_heard_ns);
  }
  frames::TimeNs forget_before_ns = oldest_ns;
  if (gone_ns.size() > kMaxGone) {
    std::nth_element(gone_ns.begin(), gone_ns.end() - kMaxGone, gone_ns.end());
    forget_before_ns = std::max(forget_before_ns, gone_ns[gone_ns.size() - kMaxGone]);
  }
  std::erase_if(tracks, [&](const Track& track) {
    return track.source.state == SourceState::kGone &&
           track.source.found.last_heard_ns < forget_before_ns;
  });
}

void SourceRegister::IndexPlaces() {
  hits_.assign(state_.tracks.size(), {});
  std::vector<Eigen::Vector3d> places;
  places.reserve(state_.tracks.size());
  for (const Track& track : state_.tracks) places.push_back(track.source.found.position_in_map_m);
  places_.Set(std::move(places));
}

std::vector<RegisteredSource> SourceRegister::Sources() const {
  std::vector<RegisteredSource> sources;
  sources.reserve(state_.tracks.size());
  for (const Track& track : state_.tracks) {
    if (!track.left) sources.push_back(Describe(track));
  }
  std::sort(sources.begin(), sources.end(), [](const auto& a, const auto& b) {
    return a.found.probability != b.found.probability ? a.found.probability > b.found.probability
                                                      : a.found.id < b.found.id;
  });
  return sources;
}

}  // namespace soundmap::sound_map
