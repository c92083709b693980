#include "storage/session_log.h"

#include "tests/fuzz/fields.h"
#include "tests/fuzz/target.h"
#include "tests/fuzz/temporary_folder.h"

namespace soundmap::fuzz {
namespace {

const TemporaryFolder& Folder() {
  static const TemporaryFolder folder;
  return folder;
}

std::string SegmentName(int first) {
  const std::string digits = std::to_string(first);
  return std::string(20 - digits.size(), '0') + digits + ".mcap";
}

recording::Message Frame(int number) {
  recording::Message message;
  message.topic = number % 2 == 0 ? "/odom" : "/scan";
  message.schema = number % 2 == 0 ? "foxglove.Odometry" : "foxglove.LaserScan";
  message.log_time_ns = 1000 + number;
  message.data.assign(30, static_cast<char>('a' + number));
  return message;
}

}  // namespace

// The first segment, the offset of another one, and that: with a regular end and without.
std::vector<std::string> Seeds() {
  std::vector<std::string> seeds;
  for (const bool closed : {true, false}) {
    const std::string folder = Folder().Empty("seed");
    for (int segment = 0; segment < 2; ++segment) {
      const auto log = storage::SessionLog::Open(folder).value();
      for (int i = 0; i < 5; ++i) {
        Require(log->Append(Frame(5 * segment + i)).ok() && log->Sync().ok());
      }
      if (closed) Require(log->Close().ok());
    }
    seeds.push_back(MakeField(ReadFile(folder + "/" + SegmentName(0))) + '\5' +
                    ReadFile(folder + "/" + SegmentName(5)));
  }
  return seeds;
}

void Decode(std::string_view bytes) {
  const std::string folder = Folder().Empty("log");
  WriteFile(folder + "/" + SegmentName(0), TakeField(bytes));
  if (!bytes.empty()) {
    WriteFile(folder + "/" + SegmentName(static_cast<unsigned char>(bytes[0])), bytes.substr(1));
  }
  (void)storage::CheckSessionLog(folder, 0);
  std::int64_t durable = 0;
  {
    storage::SessionLogOptions options;
    options.min_free_bytes = 0;
    const auto log = storage::SessionLog::Open(folder, options);
    if (!log.ok()) return;
    durable = (*log)->durable();
    Require((*log)->received() == durable);
    // All that is said to be there is read, or an error stays.
    const auto reader = (*log)->Read(0).value();
    bool whole = true;
    for (std::int64_t i = 0; whole && i < durable; ++i) {
      const auto frame = reader->Next();
      whole = frame.ok();
      if (whole) Require(frame->has_value());
    }
    if (whole) Require(!reader->Next().value());
    if (!whole) Require(!reader->Next().ok());
    // It goes on behind what was there.
    if (!(*log)->Append(Frame(0)).ok()) return;  // a topic that had another schema
    Require((*log)->Sync().value() == durable + 1);
  }
  const auto again = storage::SessionLog::Open(folder, {}, durable + 1);
  Require(again.ok() && (*again)->durable() == durable + 1);
  const auto last = (*again)->Read(durable).value()->Next();
  Require(last.ok() && last->has_value() && (*last)->data == Frame(0).data);
}

}  // namespace soundmap::fuzz
