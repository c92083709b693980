#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/commit.h"

namespace soundmap::storage {

// The value of a journal entry, as FORMAT.md says. Likelihoods keep their bits, end points their
// order. InvalidArgument: more than 2^20 end points or 2^16 maxima, or a summary longer than 64
// KiB.
absl::StatusOr<std::string> EncodeJournalEntry(const std::string& session,
                                               const JournalEntry& entry);

// `record.sequence` is left as it is. DataLoss for bytes that EncodeJournalEntry() does not make;
// memory stays bounded whatever they say.
absl::Status DecodeJournalEntry(std::string_view bytes, JournalRecord* record);

}  // namespace soundmap::storage
