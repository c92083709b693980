#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "recording/drive.h"
#include "recording/reader.h"
#include "sources/frame_source.h"

namespace soundmap::sources {

// A recorded drive as a source of frames: its audio, LIDAR, LRF and odometry messages in the order
// of the file; nothing else of it, ground truth least of all.
class Replay : public FrameSource {
 public:
  // Reads the drive once from front to back. Errors of the reader; InvalidArgument: no sensor
  // message, a topic of another schema, a sensor or microphone whose place is not given.
  static absl::StatusOr<std::unique_ptr<Replay>> Open(const std::string& path,
                                                      const recording::DriveTopics& topics = {});

  // A damaged drive ends at the damage; survey().damage says so.
  absl::Status Seek(std::int64_t offset) override;
  absl::StatusOr<std::optional<SensorFrame>> Next() override;

  const recording::DriveSurvey& survey() const { return survey_; }
  const recording::RobotModel& robot() const { return robot_; }
  // What a listening drive lacks, a sentence each.
  std::vector<std::string> ListeningWarnings() const;

  // "r-" and 16 hexadecimal digits of a hash of the arguments, the file's bytes and the topics: the
  // same replay is the same session.
  std::string SessionId(std::string_view site, std::string_view robot,
                        std::string_view purpose) const;

 private:
  Replay(std::string path, recording::DriveTopics topics)
      : path_(std::move(path)), topics_(std::move(topics)) {}
  std::optional<Sensor> SensorOf(const std::string& topic) const;

  const std::string path_;
  const recording::DriveTopics topics_;
  recording::DriveSurvey survey_;
  recording::RobotModel robot_;
  std::string file_sha256_;
  std::unique_ptr<recording::Reader> reader_;
};

}  // namespace soundmap::sources
