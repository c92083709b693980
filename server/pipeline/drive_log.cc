#include "pipeline/drive_log.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace soundmap::pipeline {

absl::StatusOr<std::optional<frames::Frame>> DriveLog::Reader::Next() {
  const auto message = frames_->Next();
  if (!message.ok()) return message.status();
  if (!message->has_value()) {
    return absl::DataLossError(
        absl::StrCat("the log of session '", log_->drive_.session, "' ends early"));
  }
  auto decoded = log_->decode_(**message, log_->drive_.calibration);
  if (!decoded.ok()) return decoded.status();
  auto* frame = std::get_if<frames::Frame>(&*decoded);
  if (frame == nullptr) return std::nullopt;
  return std::move(*frame);
}

absl::StatusOr<std::unique_ptr<DriveLog>> DriveLog::Open(const SessionRecord& drive,
                                                         storage::Store* store,
                                                         const Session::FrameDecoder& decode) {
  auto log = store->OpenSession({drive.site, drive.session});
  if (!log.ok()) return log.status();
  return std::unique_ptr<DriveLog>(new DriveLog(drive, store, decode, *std::move(log)));
}

DriveLog::~DriveLog() {
  store_->CloseSession({drive_.site, drive_.session}).IgnoreError();  // nothing was appended
}

absl::StatusOr<DriveLog::Reader> DriveLog::Read(std::int64_t offset) const {
  auto frames = log_->Read(offset);
  if (!frames.ok()) return frames.status();
  return Reader(this, *std::move(frames));
}

}  // namespace soundmap::pipeline
