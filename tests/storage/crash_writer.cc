// Drives a session until it is killed: crash_writer DATA_DIR. After each sync it writes the durable
// count to standard output as 8 bytes, after each commit the processed count with the top bit set,
// after each record put its number with the second bit set.

#include <unistd.h>

#include <cstdint>
#include <cstdio>

#include "storage/frame_sequence.h"
#include "storage/store.h"

namespace {

using namespace soundmap::storage;

bool Tell(std::uint64_t number) {
  return ::write(STDOUT_FILENO, &number, sizeof(number)) == sizeof(number);
}

absl::Status Run(const std::string& data_dir) {
  StoreOptions options;
  options.session_log.segment_bytes = 20'000;
  auto store = Store::Open(data_dir, options);
  if (!store.ok()) return store.status();
  const SessionId id{"hall", "drive"};
  auto log = (*store)->OpenSession(id);
  if (!log.ok()) return log.status();
  std::uint64_t records = (*store)->ListRecords(Table::kServer, "")->size();
  std::int64_t processed = *(*store)->ProcessedOffset(id);
  while (true) {
    for (std::int64_t end = (*log)->received() + 1 + (*log)->received() % 7;
         (*log)->received() < end;) {
      if (auto appended = (*log)->Append(FrameAt((*log)->received())); !appended.ok()) {
        return appended.status();
      }
    }
    const auto durable = (*log)->Sync();
    if (!durable.ok()) return durable.status();
    if (!Tell(static_cast<std::uint64_t>(*durable))) return absl::OkStatus();

    Commit commit{id.site, id.session, *durable, *durable, {}, {}, StateAt(*durable)};
    for (; processed < *durable; ++processed) {
      if (processed % 3 == 0) commit.journal.push_back(EntryAt(processed));
    }
    if (auto committed = (*store)->CommitBatch(commit); !committed.ok()) return committed.status();
    if (!Tell(static_cast<std::uint64_t>(*durable) | std::uint64_t{1} << 63)) {
      return absl::OkStatus();
    }
    if (*durable % 5 == 0) {
      ++records;
      if (auto put = (*store)->PutRecord(Table::kServer, std::to_string(records), "x"); !put.ok()) {
        return put;
      }
      if (!Tell(records | std::uint64_t{1} << 62)) return absl::OkStatus();
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const absl::Status status = Run(argv[1]);
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
