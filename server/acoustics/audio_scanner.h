#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "acoustics/audio_clock.h"
#include "acoustics/config.h"
#include "acoustics/likelihood_scan.h"
#include "acoustics/peak_finder.h"
#include "acoustics/peak_ripple.h"
#include "acoustics/polarity.h"
#include "acoustics/srp_phat.h"
#include "acoustics/stft.h"
#include "frames/frames.h"

namespace soundmap::acoustics {

// Sections III and IV for one robot: audio blocks in, likelihood scans out, one every K W/2
// samples. The scans are a deterministic function of the blocks; how samples are cut into blocks
// does not change their likelihoods. Scanners with one configuration and array share their tables.
// One thread at a time.
class AudioScanner {
 public:
  // What the past leaves behind, all of it.
  struct State {
    frames::TimeNs last_stamp_ns = 0;  // of the last block
    std::int64_t next_sample = 0;      // count since the last gap: of the first sample to come
    std::vector<AudioClock::Point> clock;
    std::vector<std::int16_t> pending;  // interleaved, not yet scanned; they end before next_sample
    Polarity::State polarity;

    bool operator==(const State&) const = default;
  };

  // InvalidArgument: what Calibration::Validate(), FrameLayout::Create() and SrpPhat::Create()
  // refuse; a calibration without microphones.
  static absl::StatusOr<std::unique_ptr<AudioScanner>> Create(
      const AcousticsConfig& config, const frames::Calibration& calibration);

  // The scans that this block completes, in time order. A block that starts more than 20 ms after
  // the end of the last one follows a gap: framing starts anew with it, and a scan with a fault
  // tells what was left over. A microphone that stands still for the whole scan is dead and is done
  // without, while three quarters of them remain; a scan in which one stands still for W/2 samples
  // or more (dropped samples, too many dead) has a fault. One whose polarity is known to be
  // inverted has its sign turned (both with PeakEvidence alone). InvalidArgument, and no change:
  // another sample rate or number of channels than the calibration's, samples that do not fill the
  // channels, a block that starts more than 20 ms before the end of the last one or before its
  // stamp, a stamp outside 1970 .. 2116.
  absl::StatusOr<std::vector<LikelihoodScan>> Push(const frames::AudioBlock& block);

  // Of the work on one scan, in their order.
  enum class Step { kSpectra, kPower, kEvidence };
  // Calls `done` at the end of each step, for those who measure.
  void WatchSteps(std::function<void(Step)> done) { step_done_ = std::move(done); }

  State state() const;
  // InvalidArgument, and no change: a state that no scanner with this configuration can have had.
  absl::Status Restore(State state);

  // The likelihoods of a scan again, once more is known of its peaks (PeakEvidence alone).
  std::vector<float> Likelihood(std::span<const Peak> peaks) const;

  // Of microphones in a plane, with PeakEvidence.
  std::optional<Eigen::Vector3d> array_normal() const;

  const geometry::DirectionGrid& grid() const;
  const FrameLayout& layout() const { return layout_; }

 private:
  // What depends on the configuration and the array alone: shared by all scanners with the same.
  struct Tables;
  static absl::StatusOr<std::shared_ptr<const Tables>> MakeTables(
      const AcousticsConfig& config, const frames::Calibration& calibration);
  static absl::StatusOr<std::shared_ptr<const Tables>> SharedTables(
      const AcousticsConfig& config, const frames::Calibration& calibration);

  // The scanner of what is left of the array.
  struct Remainder {
    std::vector<int> dead;
    std::shared_ptr<const Tables> tables;
    Stft stft;
  };
  Remainder* RemainderWithout(const std::vector<int>& dead);

  explicit AudioScanner(std::shared_ptr<const Tables> tables);
  LikelihoodScan Scan(const std::int16_t* samples, std::int64_t first_sample);
  // A sentence, or the microphones to do without.
  std::string FaultIn(const std::int16_t* samples, std::vector<int>& dead) const;
  // Into mended_: without the dead ones, with the sign of the inverted ones turned.
  void Mend(const std::int16_t* samples, const std::vector<int>& dead,
            const std::vector<int>& inverted);
  void Done(Step step) const {
    if (step_done_) step_done_(step);
  }

  std::shared_ptr<const Tables> tables_;
  FrameLayout layout_;
  Stft stft_;
  Polarity polarity_;
  AudioScan scan_, rest_;                 // keep their memory from scan to scan
  PeakRipple::Frames frames_;             // likewise
  std::vector<std::int16_t> mended_;      // likewise
  std::unique_ptr<Remainder> remainder_;  // that the last scan with dead microphones needed
  AudioClock clock_;
  frames::TimeNs last_stamp_ns_ = 0;
  std::int64_t next_sample_ = 0;
  std::vector<std::int16_t> pending_;
  std::function<void(Step)> step_done_;
};

}  // namespace soundmap::acoustics
