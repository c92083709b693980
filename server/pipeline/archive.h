#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "pipeline/events.h"
#include "sound_map/source_register.h"

namespace soundmap::pipeline {

// The pipeline's own bytes in the store: doubles as they are, so that what is read is what was
// written, bit for bit.
std::string EncodePose(const localization::PoseEstimate& pose);
std::string EncodeAudioScan(
    const AudioScanInfo& scan);  // without the session and the time, which the journal keeps

// Of all the maps of a site, by their numbers.
using SourceRegisters = std::vector<sound_map::SourceRegister::State>;
std::string EncodeSourceRegisters(const SourceRegisters& registers);

// DataLoss: not such bytes.
absl::StatusOr<localization::PoseEstimate> DecodePose(const std::string& bytes);
absl::StatusOr<AudioScanInfo> DecodeAudioScan(const std::string& bytes);
absl::StatusOr<SourceRegisters> DecodeSourceRegisters(const std::string& bytes);

}  // namespace soundmap::pipeline
