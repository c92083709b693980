#include "recording/writer.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <utility>

#include "absl/strings/str_cat.h"
#include "recording/schemas.h"
#include "recording/wire.h"

namespace soundmap::recording {
namespace {

absl::Status FileError(const std::string& what, const std::string& path) {
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot ", what, " '", path, "'"));
}

void AppendSummaryGroup(Opcode opcode, std::string_view records, std::uint64_t file_offset,
                        std::string& summary, std::string& offsets) {
  if (records.empty()) return;
  const std::size_t record = BeginRecord(offsets, Opcode::kSummaryOffset);
  offsets.push_back(static_cast<char>(opcode));
  AppendU64(offsets, file_offset + summary.size());
  AppendU64(offsets, records.size());
  EndRecord(offsets, record);
  summary.append(records);
}

}  // namespace

void Writer::TimeRange::Add(std::uint64_t time_ns) {
  first_ns = empty ? time_ns : std::min(first_ns, time_ns);
  last_ns = empty ? time_ns : std::max(last_ns, time_ns);
  empty = false;
}

absl::StatusOr<std::unique_ptr<Writer>> Writer::Create(const std::string& path,
                                                       const WriterOptions& options) {
  if (options.chunk_bytes < 1 || options.chunk_bytes > (256 << 20)) {
    return absl::InvalidArgumentError(
        absl::StrCat("chunk_bytes is ", options.chunk_bytes, "; it must be 1 .. 256 MiB"));
  }
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0666);
  if (file < 0) return FileError("create", path);
  std::unique_ptr<Writer> writer(new Writer(path, file, options));
  struct stat attributes;
  if (::fstat(file, &attributes) != 0) return FileError("inspect", path);
  if (attributes.st_size != 0) {
    return absl::FailedPreconditionError(absl::StrCat("'", path, "' exists and is not empty"));
  }
  std::string head(kMagic);
  const std::size_t record = BeginRecord(head, Opcode::kHeader);
  AppendString(head, "");
  AppendString(head, "soundmap");
  EndRecord(head, record);
  if (absl::Status status = writer->Emit(head); !status.ok()) return status;
  return writer;
}

Writer::Writer(std::string path, int file, const WriterOptions& options)
    : path_(std::move(path)), options_(options), file_(file) {}

Writer::~Writer() {
  if (file_ >= 0) ::close(file_);
}

absl::Status Writer::Write(std::string_view topic, std::string_view schema,
                           std::int64_t log_time_ns, std::uint32_t sequence,
                           std::string_view data) {
  if (!status_.ok()) return status_;
  if (file_ < 0) return absl::FailedPreconditionError(absl::StrCat("'", path_, "' is closed"));
  if (log_time_ns < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("a message on ", std::string(topic), " has the time ", log_time_ns, " ns"));
  }
  absl::StatusOr<Channel*> channel = FindOrAddChannel(topic, schema);
  if (!channel.ok()) return channel.status();

  const auto time_ns = static_cast<std::uint64_t>(log_time_ns);
  if (options_.chunked && options_.summary) {
    chunk_index_[(*channel)->id].emplace_back(time_ns, records_.size());
  }
  chunk_times_.Add(time_ns);
  file_times_.Add(time_ns);
  ++(*channel)->message_count;
  const std::size_t record = BeginRecord(records_, Opcode::kMessage);
  AppendU16(records_, (*channel)->id);
  AppendU32(records_, sequence);
  AppendU64(records_, time_ns);
  AppendU64(records_, time_ns);
  records_.append(data);
  EndRecord(records_, record);
  if (static_cast<std::int64_t>(records_.size()) < options_.chunk_bytes) return absl::OkStatus();
  return CloseChunk();
}

absl::StatusOr<Writer::Channel*> Writer::FindOrAddChannel(std::string_view topic,
                                                          std::string_view schema) {
  if (const auto known = channels_.find(topic); known != channels_.end()) {
    if (known->second.schema == schema) return &known->second;
    return absl::InvalidArgumentError(absl::StrCat("the topic ", std::string(topic),
                                                   " has the schema ", known->second.schema,
                                                   ", not ", std::string(schema)));
  }
  if (channels_.size() == 0xffff) {
    return absl::InvalidArgumentError(absl::StrCat("'", path_, "' has 65535 topics already"));
  }
  auto schema_entry = schemas_.find(schema);
  if (schema_entry == schemas_.end()) {
    const std::optional<std::string> descriptors = DescriptorSetOf(schema);
    if (!descriptors) {
      return absl::InvalidArgumentError(
          absl::StrCat("'", std::string(schema), "' is not a schema of the recording format"));
    }
    const auto id = static_cast<std::uint16_t>(schemas_.size() + 1);
    schema_entry = schemas_.emplace(std::string(schema), id).first;
    std::string schema_record;
    const std::size_t record = BeginRecord(schema_record, Opcode::kSchema);
    AppendU16(schema_record, id);
    AppendString(schema_record, schema);
    AppendString(schema_record, "protobuf");
    AppendString(schema_record, *descriptors);
    EndRecord(schema_record, record);
    records_.append(schema_record);
    schema_records_.append(schema_record);
  }
  const auto id = static_cast<std::uint16_t>(channels_.size() + 1);
  std::string channel_record;
  const std::size_t record = BeginRecord(channel_record, Opcode::kChannel);
  AppendU16(channel_record, id);
  AppendU16(channel_record, schema_entry->second);
  AppendString(channel_record, topic);
  AppendString(channel_record, "protobuf");
  AppendU32(channel_record, 0);  // no metadata
  EndRecord(channel_record, record);
  records_.append(channel_record);
  channel_records_.append(channel_record);
  return &channels_.emplace(std::string(topic), Channel{id, std::string(schema)}).first->second;
}

absl::Status Writer::CloseChunk() {
  if (!status_.ok()) return status_;
  if (records_.empty()) return absl::OkStatus();
  if (!options_.chunked) {
    absl::Status status = Emit(records_);
    records_.clear();
    return status;
  }
  chunk_.clear();
  const std::size_t chunk = BeginRecord(chunk_, Opcode::kChunk);
  AppendU64(chunk_, chunk_times_.first_ns);
  AppendU64(chunk_, chunk_times_.last_ns);
  AppendU64(chunk_, records_.size());
  AppendU32(chunk_, ExtendCrc32(0, records_));
  AppendString(chunk_, CompressionName(options_.compression));
  const std::size_t length_position = chunk_.size();
  AppendU64(chunk_, 0);
  const std::size_t data_position = chunk_.size();
  if (status_ = CompressChunk(options_.compression, records_, chunk_); !status_.ok()) {
    return status_;
  }
  const std::size_t data_bytes = chunk_.size() - data_position;
  std::string length;
  AppendU64(length, data_bytes);
  chunk_.replace(length_position, length.size(), length);
  EndRecord(chunk_, chunk);
  const std::size_t chunk_record_bytes = chunk_.size();

  if (options_.summary) {
    std::string offsets;
    for (const auto& [channel, messages] : chunk_index_) {
      AppendU16(offsets, channel);
      AppendU64(offsets, size_bytes_ + chunk_.size());
      const std::size_t record = BeginRecord(chunk_, Opcode::kMessageIndex);
      AppendU16(chunk_, channel);
      AppendU32(chunk_, static_cast<std::uint32_t>(messages.size() * 16));
      for (const auto& [time_ns, offset] : messages) {
        AppendU64(chunk_, time_ns);
        AppendU64(chunk_, offset);
      }
      EndRecord(chunk_, record);
    }
    const std::size_t record = BeginRecord(chunk_index_records_, Opcode::kChunkIndex);
    AppendU64(chunk_index_records_, chunk_times_.first_ns);
    AppendU64(chunk_index_records_, chunk_times_.last_ns);
    AppendU64(chunk_index_records_, size_bytes_);
    AppendU64(chunk_index_records_, chunk_record_bytes);
    AppendString(chunk_index_records_, offsets);
    AppendU64(chunk_index_records_, chunk_.size() - chunk_record_bytes);
    AppendString(chunk_index_records_, CompressionName(options_.compression));
    AppendU64(chunk_index_records_, data_bytes);
    AppendU64(chunk_index_records_, records_.size());
    EndRecord(chunk_index_records_, record);
  }
  ++chunk_count_;
  records_.clear();
  chunk_index_.clear();
  chunk_times_ = {};
  return Emit(chunk_);
}

absl::Status Writer::Emit(std::string_view bytes) {
  for (std::string_view rest = bytes; !rest.empty();) {
    const ssize_t written = ::write(file_, rest.data(), rest.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      status_ = FileError("write to", path_);
      if (::ftruncate(file_, size_bytes_) != 0) {
        status_ = absl::Status(status_.code(),
                               absl::StrCat(status_.message(), "; nor can it be cut back"));
      }
      return status_;
    }
    rest.remove_prefix(static_cast<std::size_t>(written));
  }
  file_crc_ = ExtendCrc32(file_crc_, bytes);
  size_bytes_ += static_cast<std::int64_t>(bytes.size());
  return absl::OkStatus();
}

absl::Status Writer::Flush(bool sync) {
  if (!status_.ok()) return status_;
  if (file_ < 0) return absl::FailedPreconditionError(absl::StrCat("'", path_, "' is closed"));
  if (absl::Status status = CloseChunk(); !status.ok()) return status;
  // After a failed fdatasync the kernel may have dropped the pages: nothing that follows can be
  // trusted.
  if (sync && ::fdatasync(file_) != 0) status_ = FileError("sync", path_);
  return status_;
}

std::string Writer::Summary() const {
  const auto begin = static_cast<std::uint64_t>(size_bytes_);
  std::string summary;
  std::string offsets;
  if (options_.summary) {
    std::string statistics;
    const std::size_t record = BeginRecord(statistics, Opcode::kStatistics);
    std::uint64_t message_count = 0;
    std::string counts;
    for (const auto& [topic, channel] : channels_) {
      message_count += channel.message_count;
      AppendU16(counts, channel.id);
      AppendU64(counts, channel.message_count);
    }
    AppendU64(statistics, message_count);
    AppendU16(statistics, static_cast<std::uint16_t>(schemas_.size()));
    AppendU32(statistics, static_cast<std::uint32_t>(channels_.size()));
    AppendU32(statistics, 0);  // attachments
    AppendU32(statistics, 0);  // metadata
    AppendU32(statistics, chunk_count_);
    AppendU64(statistics, file_times_.first_ns);
    AppendU64(statistics, file_times_.last_ns);
    AppendString(statistics, counts);
    EndRecord(statistics, record);

    AppendSummaryGroup(Opcode::kSchema, schema_records_, begin, summary, offsets);
    AppendSummaryGroup(Opcode::kChannel, channel_records_, begin, summary, offsets);
    AppendSummaryGroup(Opcode::kStatistics, statistics, begin, summary, offsets);
    AppendSummaryGroup(Opcode::kChunkIndex, chunk_index_records_, begin, summary, offsets);
  }
  const std::uint64_t offsets_begin = begin + summary.size();
  summary.append(offsets);
  const std::size_t footer = BeginRecord(summary, Opcode::kFooter);
  AppendU64(summary, options_.summary ? begin : 0);
  AppendU64(summary, offsets.empty() ? 0 : offsets_begin);
  AppendU32(summary, 0);
  EndRecord(summary, footer);
  summary.resize(summary.size() - 4);
  AppendU32(summary, ExtendCrc32(0, summary));
  return summary;
}

absl::Status Writer::Close() {
  if (absl::Status status = Flush(/*sync=*/false); !status.ok()) return status;
  std::string data_end;
  const std::size_t record = BeginRecord(data_end, Opcode::kDataEnd);
  AppendU32(data_end, file_crc_);
  EndRecord(data_end, record);
  if (absl::Status status = Emit(data_end); !status.ok()) return status;
  std::string summary = Summary();
  summary.append(kMagic);
  if (absl::Status status = Emit(summary); !status.ok()) return status;
  if (::close(std::exchange(file_, -1)) != 0) status_ = FileError("close", path_);
  return status_;
}

}  // namespace soundmap::recording
