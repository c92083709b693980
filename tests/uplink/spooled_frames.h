#pragma once

#include <atomic>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>
#include <string>

#include "foxglove/KeyValuePair.pb.h"
#include "spool/spool.h"

namespace soundmap::spool {

// The frame at a position of a drive: always the same, each different.
inline sources::SensorFrame FrameAt(std::int64_t position) {
  std::mt19937 random(static_cast<unsigned>(position));
  sources::SensorFrame frame;
  frame.sensor = static_cast<sources::Sensor>(random() % 4);
  frame.log_time_ns = 1'000'000'000 + 20'000'000 * position;
  frame.payload.resize(random() % 600);
  for (char& byte : frame.payload) byte = static_cast<char>(random());
  return frame;
}

inline bool Same(const sources::SensorFrame& a, const sources::SensorFrame& b) {
  return a.sensor == b.sensor && a.log_time_ns == b.log_time_ns && a.payload == b.payload;
}

// How many frames a gap record stands for.
inline std::int64_t LostBy(const sources::SensorFrame& gap, std::string* reason = nullptr) {
  foxglove::KeyValuePair pair;
  if (!pair.ParseFromString(gap.payload) || pair.key() != "gap") return -1;
  const auto value = nlohmann::json::parse(pair.value());
  if (reason != nullptr) *reason = value.at("reason").get<std::string>();
  return value.at("frames").get<std::int64_t>();
}

inline v1::CreateSessionRequest RequestFor(const std::string& session) {
  v1::CreateSessionRequest request;
  request.set_site("sites/hall");
  request.set_robot("robots/r");
  request.set_session_id(session);
  request.set_purpose(v1::PURPOSE_LISTENING);
  request.mutable_calibration()->add_mic_in_array_m()->set_x(0.25);
  return request;
}

inline SpoolOptions SmallSegments() {
  SpoolOptions options;
  options.segment_bytes = 4000;
  options.sync_bytes = 1000;
  options.sync_interval = std::chrono::milliseconds(2);
  return options;
}

inline std::unique_ptr<Spool> Reopen(const std::filesystem::path& folder,
                                     const SpoolOptions& options) {
  // A clock that goes on with every look at it.
  static std::atomic<std::int64_t> now_ns = 1'700'000'000'000'000'000;
  auto spool = Spool::Open(folder.string(), options, [] { return now_ns += 1000; });
  if (!spool.ok()) throw std::runtime_error(std::string(spool.status().message()));
  return *std::move(spool);
}

}  // namespace soundmap::spool
