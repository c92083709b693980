#include "spool/session_files.h"

#include <fcntl.h>
#include <google/protobuf/util/json_util.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "recording/reader.h"

namespace soundmap::spool {
namespace {

constexpr char kRecordName[] = "session.json";
constexpr char kSuffix[] = ".mcap";
constexpr std::size_t kDigits = 20;
constexpr int kFormat = 1;
// Of a drive; 300 years at 100 frames a second. What says more is damaged.
constexpr std::int64_t kMaxFrames = std::int64_t{1} << 40;

std::optional<std::int64_t> FirstOf(const std::string& name) {
  if (name.size() != kDigits + sizeof(kSuffix) - 1 || name.substr(kDigits) != kSuffix) {
    return std::nullopt;
  }
  std::int64_t first = 0;
  const char* const end = name.data() + kDigits;
  const auto [stop, error] = std::from_chars(name.data(), end, first);
  if (error != std::errc() || stop != end || first < 0 || first > kMaxFrames) return std::nullopt;
  return first;
}

absl::Status SyncPath(const std::string& path, int flags) {
  const int file = ::open(path.c_str(), flags | O_CLOEXEC);
  if (file < 0) return absl::ErrnoToStatus(errno, absl::StrCat("cannot open ", path));
  const int failed = ::fsync(file);
  const int why = errno;
  ::close(file);
  return failed == 0 ? absl::OkStatus()
                     : absl::ErrnoToStatus(why, absl::StrCat("cannot sync ", path));
}

// Whether the gaps are in order, and each stands where the ones before it have moved it.
bool FitTogether(const SessionRecord& record) {
  if (record.next < 0 || record.next > kMaxFrames) return false;
  std::int64_t end = 0;
  std::int64_t shrunk = 0;  // frames that the server does not get, so far
  for (const Gap& gap : record.gaps) {
    if (gap.first < end || gap.end <= gap.first || gap.end > record.next ||
        gap.offset != gap.first - shrunk) {
      return false;
    }
    end = gap.end;
    shrunk += gap.end - gap.first - 1;
  }
  return true;
}

// A fraction or what 64 bits cannot hold is an error; get() would cast it as it comes.
std::int64_t IntegerFrom(const nlohmann::json& json) {
  const bool fits = json.is_number_unsigned()
                        ? std::in_range<std::int64_t>(json.get<std::uint64_t>())
                        : json.is_number_integer();
  if (!fits) {
    throw nlohmann::json::type_error::create(302, "a number is no integer of 64 bits", &json);
  }
  return json.get<std::int64_t>();
}

}  // namespace

std::string SegmentPath(const std::string& folder, std::int64_t first) {
  return absl::StrFormat("%s/%0*d%s", folder, static_cast<int>(kDigits), first, kSuffix);
}

absl::StatusOr<std::vector<Segment>> ListSegments(const std::string& folder) {
  std::vector<Segment> segments;
  std::error_code error;
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    const auto first = FirstOf(it->path().filename().string());
    struct stat file = {};
    if (!first || ::stat(it->path().c_str(), &file) != 0) continue;
    segments.push_back({*first, it->path().string(), file.st_size,
                        file.st_mtim.tv_sec * 1'000'000'000 + file.st_mtim.tv_nsec});
  }
  if (error) return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot list ", folder));
  std::sort(segments.begin(), segments.end(),
            [](const Segment& a, const Segment& b) { return a.first < b.first; });
  return segments;
}

absl::Status WriteRecord(const std::string& folder, const SessionRecord& record) {
  std::string request;
  google::protobuf::util::JsonPrintOptions options;
  options.preserve_proto_field_names = true;
  if (!google::protobuf::util::MessageToJsonString(record.request, &request, options).ok()) {
    return absl::InternalError("a session cannot be written as JSON");
  }
  nlohmann::json json = {{"format", kFormat},
                         {"request", nlohmann::json::parse(request)},
                         {"created_ns", record.created_ns},
                         {"next", record.next},
                         {"ended", record.ended},
                         {"delivered", record.delivered},
                         {"gaps", nlohmann::json::array()}};
  for (const Gap& gap : record.gaps) {
    json["gaps"].push_back({{"offset", gap.offset},
                            {"first", gap.first},
                            {"end", gap.end},
                            {"from_ns", gap.from_ns},
                            {"to_ns", gap.to_ns},
                            {"reason", gap.reason}});
  }
  const std::string path = absl::StrCat(folder, "/", kRecordName);
  const std::string draft = path + ".new";
  {
    std::ofstream file(draft, std::ios::binary | std::ios::trunc);
    file << json.dump(1) << '\n';
    file.close();
    if (!file) {
      return absl::ResourceExhaustedError(absl::StrCat("cannot write ", draft, ": disk full?"));
    }
  }
  if (absl::Status synced = SyncPath(draft, O_RDONLY); !synced.ok()) return synced;
  if (::rename(draft.c_str(), path.c_str()) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot rename ", draft));
  }
  return SyncFolder(folder);
}

absl::StatusOr<SessionRecord> ReadRecord(const std::string& folder) {
  const std::string path = absl::StrCat(folder, "/", kRecordName);
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (!file) return absl::NotFoundError(absl::StrCat("cannot read ", path));
  SessionRecord record;
  try {
    const nlohmann::json json = nlohmann::json::parse(text);
    if (IntegerFrom(json.at("format")) != kFormat) {
      return absl::FailedPreconditionError(
          absl::StrCat(path, " was written by another version of soundmap-robot"));
    }
    if (!google::protobuf::util::JsonStringToMessage(json.at("request").dump(), &record.request)
             .ok()) {
      return absl::DataLossError(absl::StrCat(path, " names no session"));
    }
    record.created_ns = IntegerFrom(json.at("created_ns"));
    record.next = IntegerFrom(json.at("next"));
    record.ended = json.at("ended").get<bool>();
    record.delivered = json.at("delivered").get<bool>();
    for (const nlohmann::json& gap : json.at("gaps")) {
      record.gaps.push_back({IntegerFrom(gap.at("offset")), IntegerFrom(gap.at("first")),
                             IntegerFrom(gap.at("end")), IntegerFrom(gap.at("from_ns")),
                             IntegerFrom(gap.at("to_ns")), gap.at("reason").get<std::string>()});
    }
  } catch (const nlohmann::json::exception& error) {
    return absl::DataLossError(absl::StrCat(path, " is damaged: ", error.what()));
  }
  if (!FitTogether(record)) {
    return absl::DataLossError(absl::StrCat(path, " is damaged: its numbers do not fit together"));
  }
  return record;
}

absl::Status SyncFolder(const std::string& folder) {
  return SyncPath(folder, O_RDONLY | O_DIRECTORY);
}

absl::StatusOr<std::int64_t> CountFrames(const std::string& path) {
  auto reader = recording::Reader::Open(path);
  if (!reader.ok()) {
    if (absl::IsInvalidArgument(reader.status()) || absl::IsDataLoss(reader.status())) return 0;
    return reader.status();
  }
  std::int64_t count = 0;
  while (true) {
    const auto message = (*reader)->Next();
    if (absl::IsDataLoss(message.status()) || (message.ok() && !message->has_value())) return count;
    if (!message.ok()) return message.status();
    ++count;
  }
}

std::int64_t PositionOf(const SessionRecord& record, std::int64_t offset) {
  std::int64_t position = offset;
  for (const Gap& gap : record.gaps) {
    if (gap.offset < offset) position += gap.end - gap.first - 1;
  }
  return position;
}

}  // namespace soundmap::spool
