#include "sources/replay/replay.h"

#include <openssl/evp.h>

#include <cerrno>
#include <cstdio>
#include <memory>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace soundmap::sources {
namespace {

class Sha256 {
 public:
  Sha256() : context_(EVP_MD_CTX_new(), &EVP_MD_CTX_free) {
    EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr);
  }
  void Add(std::string_view bytes) { EVP_DigestUpdate(context_.get(), bytes.data(), bytes.size()); }
  // With its length, so that no two lists of fields give the same bytes.
  void AddField(std::string_view field) {
    Add(absl::StrCat(field.size(), ":"));
    Add(field);
  }
  std::string Digest() {
    unsigned char digest[EVP_MAX_MD_SIZE];
    unsigned int bytes = 0;
    EVP_DigestFinal_ex(context_.get(), digest, &bytes);
    return std::string(reinterpret_cast<const char*>(digest), bytes);
  }

 private:
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_;
};

absl::StatusOr<std::string> Sha256OfFile(const std::string& path) {
  const std::unique_ptr<std::FILE, decltype(&std::fclose)> file(std::fopen(path.c_str(), "rbe"),
                                                                &std::fclose);
  if (file == nullptr) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot open '", path, "'"));
  }
  Sha256 hash;
  std::vector<char> buffer(1 << 18);
  std::size_t bytes = 0;
  do {
    bytes = std::fread(buffer.data(), 1, buffer.size(), file.get());
    hash.Add(std::string_view(buffer.data(), bytes));
  } while (bytes == buffer.size());
  if (std::ferror(file.get()) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read '", path, "'"));
  }
  return hash.Digest();
}

}  // namespace

absl::StatusOr<std::unique_ptr<Replay>> Replay::Open(const std::string& path,
                                                     const recording::DriveTopics& topics) {
  std::unique_ptr<Replay> replay(new Replay(path, topics));
  auto survey = recording::SurveyDrive(path, topics);
  if (!survey.ok()) return survey.status();
  replay->survey_ = *std::move(survey);
  const recording::DriveSurvey& found = replay->survey_;
  if (found.sensor_count() == 0) {
    if (!found.damage.ok()) return found.damage;
    return absl::InvalidArgumentError(absl::StrCat("'", path, "' has no message on ", topics.audio,
                                                   ", ", topics.lidar, ", ", topics.laser, " or ",
                                                   topics.odometry));
  }
  auto robot = recording::MakeRobotModel(found.transforms, found.audio_channels);
  if (!robot.ok()) {
    return absl::Status(robot.status().code(),
                        absl::StrCat("'", path, "': ", robot.status().message()));
  }
  replay->robot_ = *std::move(robot);
  for (const auto& [count, mount, frame] :
       {std::make_tuple(found.lidar_count, replay->robot_.base_from_lidar, "lidar"),
        std::make_tuple(found.laser_count, replay->robot_.base_from_laser, "laser")}) {
    if (count == 0 || mount) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        "'", path, "': no transform on ", topics.transforms, " connects base_link and ", frame));
  }
  auto hash = Sha256OfFile(path);
  if (!hash.ok()) return hash.status();
  replay->file_sha256_ = *std::move(hash);
  if (absl::Status status = replay->Seek(0); !status.ok()) return status;
  return replay;
}

absl::Status Replay::Seek(std::int64_t offset) {
  auto reader = recording::Reader::Open(path_);
  if (!reader.ok()) return reader.status();
  reader_ = *std::move(reader);
  for (std::int64_t skipped = 0; skipped < offset; ++skipped) {
    const auto frame = Next();
    if (!frame.ok()) return frame.status();
    if (!*frame) {
      return absl::OutOfRangeError(
          absl::StrCat("'", path_, "' has ", skipped, " frames; frame ", offset, " was asked for"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<SensorFrame>> Replay::Next() {
  while (true) {
    auto message = reader_->Next();
    if (!message.ok() && !survey_.damage.ok()) return std::nullopt;
    if (!message.ok()) return message.status();
    if (!*message) return std::nullopt;
    if (const std::optional<Sensor> sensor = SensorOf((*message)->topic)) {
      return SensorFrame{*sensor, (*message)->log_time_ns, std::move((*message)->data)};
    }
  }
}

std::optional<Sensor> Replay::SensorOf(const std::string& topic) const {
  if (topic == topics_.audio) return Sensor::kAudio;
  if (topic == topics_.lidar) return Sensor::kLidar;
  if (topic == topics_.laser) return Sensor::kLaser;
  if (topic == topics_.odometry) return Sensor::kOdometry;
  return std::nullopt;
}

std::vector<std::string> Replay::ListeningWarnings() const {
  std::vector<std::string> warnings;
  for (const auto& [count, topic, what] :
       {std::make_tuple(survey_.audio_count, topics_.audio, "audio"),
        std::make_tuple(survey_.lidar_count, topics_.lidar, "LIDAR scan")}) {
    if (count > 0) continue;
    warnings.push_back(absl::StrCat("the drive has no ", what, " (", topic,
                                    "): it is localized and leaves no sound evidence"));
  }
  return warnings;
}

std::string Replay::SessionId(std::string_view site, std::string_view robot,
                              std::string_view purpose) const {
  Sha256 hash;
  for (const std::string_view field :
       {site, robot, purpose, std::string_view(file_sha256_), std::string_view(topics_.audio),
        std::string_view(topics_.lidar), std::string_view(topics_.laser),
        std::string_view(topics_.odometry)}) {
    hash.AddField(field);
  }
  return absl::StrCat("r-", absl::BytesToHexString(hash.Digest().substr(0, 8)));
}

}  // namespace soundmap::sources
