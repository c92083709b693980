#include "storage/journal_codec.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {

std::vector<std::string> Seeds() {
  std::vector<std::string> seeds;
  storage::JournalEntry entry;
  entry.offset = 7;
  entry.summary = "summary";
  entry.evidence.stamp_ns = 1'700'000'000'000'000'000;
  seeds.push_back(*storage::EncodeJournalEntry("drive", entry));
  for (int i = 0; i < 300; ++i) {
    sound_map::EndPoint point;
    point.key = {static_cast<std::uint16_t>(32768 + i % 20), static_cast<std::uint16_t>(32768 + i),
                 32770};
    point.likelihood = i % 3 == 0 ? 0.9f : 0.4f;
    entry.evidence.end_points.push_back(point);
  }
  seeds.push_back(*storage::EncodeJournalEntry("drive", entry));
  for (std::size_t i = 0; i < 300; ++i) {  // too many for classes
    entry.evidence.end_points[i].likelihood = 0.001f * static_cast<float>(i);
  }
  seeds.push_back(*storage::EncodeJournalEntry("drive", entry));
  return seeds;
}

// What is decoded means the same when it is encoded again.
void Decode(std::string_view bytes) {
  storage::JournalRecord record;
  if (!storage::DecodeJournalEntry(bytes, &record).ok()) return;
  const auto encoded = storage::EncodeJournalEntry(record.session, record.entry);
  Require(encoded.ok());
  storage::JournalRecord again;
  Require(storage::DecodeJournalEntry(*encoded, &again).ok());
  const auto once_more = storage::EncodeJournalEntry(again.session, again.entry);
  Require(once_more.ok() && *once_more == *encoded);
}

}  // namespace soundmap::fuzz
