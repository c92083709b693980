#include "storage/check.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <set>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "storage/bytes.h"
#include "storage/database.h"
#include "storage/files.h"
#include "storage/format.h"
#include "storage/journal_codec.h"
#include "storage/keys.h"
#include "storage/names.h"

namespace soundmap::storage {
namespace {

constexpr std::size_t kMaxListed = 100;

struct SessionNumbers {
  std::int64_t durable = 0;
  std::int64_t processed = 0;
  std::int64_t heard = 0;
  std::int64_t state_offset = 0;
  bool dropped = false;  // its log
};
struct SiteNumbers {
  std::uint64_t last_sequence = 0;
  std::uint64_t checkpoint = 0;
  std::uint64_t next_sequence = 0;  // of the entry that must come next; 0: none came yet
  std::int64_t entries = 0;
  std::int64_t times = 0;
};

class Check {
 public:
  Check(const std::string& data_dir, const ContentCheck& content, const DatabaseView& view)
      : data_dir_(data_dir), content_(content), view_(view) {}

  absl::StatusOr<DataCheck> Run();
  void Fault(std::string sentence) {
    if (result_.faults.size() < kMaxListed) {
      result_.faults.push_back(std::move(sentence));
    } else {
      ++unlisted_;
    }
  }

 private:
  absl::Status Scan(Family family,
                    const std::function<absl::Status(std::string_view, std::string_view)>& see) {
    // Keys begin with a table's number, a letter or digit, or 0; all below 0xff.
    return view_.Scan(family, "", "\xff", see);
  }
  void FaultUnless(const absl::Status& status, absl::string_view what) {
    if (!status.ok()) Fault(absl::StrCat(what, ": ", status.message()));
  }
  bool KnowsSite(const std::string& site) const { return sites_.count(site) != 0; }
  // The site of a key and what follows it; empty, and a fault, if the site is not known.
  std::string TakeSite(std::string_view key, std::string_view family, std::string_view* rest);

  void SeeRecord(std::string_view key, std::string_view bytes);
  void SeeState(std::string_view key, std::string_view value);
  void SeeJournal(std::string_view key, std::string_view value);
  void SeeEntry(const std::string& site, std::string_view sequence, std::string_view value);
  void SeeTime(const std::string& site, std::string_view stamp_and_sequence);
  void SeeTile(std::string_view key, std::string_view value);
  void SeePose(std::string_view key, std::string_view value);
  absl::Status CheckLogs();
  void CheckNumbers();

  const std::string data_dir_;
  const ContentCheck& content_;
  const DatabaseView& view_;
  DataCheck result_;
  std::int64_t unlisted_ = 0;
  std::map<std::string, SiteNumbers> sites_;
  std::map<SessionId, SessionNumbers> sessions_;
  std::set<std::string> deleted_sites_;
};

std::string Quoted(std::string_view bytes) {
  return absl::StrCat("'", absl::CHexEscape(absl::string_view(bytes.data(), bytes.size())), "'");
}

std::string Name(const SessionId& id) { return absl::StrCat(id.site, "/", id.session); }

std::string Check::TakeSite(std::string_view key, std::string_view family, std::string_view* rest) {
  const std::size_t end = key.find(kEnd);
  std::string site(key.substr(0, end));
  if (end != std::string_view::npos && KnowsSite(site)) {
    *rest = key.substr(end + 1);
    return site;
  }
  Fault(absl::StrCat("the key ", Quoted(key), " of ", std::string(family),
                     " belongs to no site that is known"));
  return "";
}

void Check::SeeRecord(std::string_view table_and_key, std::string_view bytes) {
  const std::string key(table_and_key.substr(std::min<std::size_t>(1, table_and_key.size())));
  const int number = table_and_key.empty() ? 0 : static_cast<unsigned char>(table_and_key[0]);
  if (number < static_cast<int>(Table::kSite) || number > static_cast<int>(Table::kServer) ||
      !ValidateRecordKey(key).ok()) {
    Fault(absl::StrCat("the record ", Quoted(table_and_key), " is of no table"));
    return;
  }
  const auto table = static_cast<Table>(number);
  const std::string site = key.substr(0, key.find('/'));
  if (table == Table::kSite) {
    sites_[key];
  } else if (table == Table::kSession || table == Table::kBuilding || table == Table::kOperation) {
    if (!KnowsSite(site)) Fault(absl::StrCat("the record ", key, " belongs to no site"));
    if (table == Table::kSession) sessions_[{site, key.substr(key.find('/') + 1)}];
  }
  if (content_.record) {
    FaultUnless(content_.record(table, key, std::string(bytes)), absl::StrCat("the record ", key));
  }
}

void Check::SeeState(std::string_view key, std::string_view value) {
  if (!key.empty() && key[0] == kEnd) {
    deleted_sites_.emplace(key.substr(1));
    return;
  }
  std::string_view rest;
  const std::string site = TakeSite(key, "state", &rest);
  if (site.empty()) return;
  if (rest == "r") return;  // made again from the journal where it cannot be read
  const bool is_state = rest.size() > 2 && rest[0] == 's' && rest.back() == 't';
  if (is_state ? value.size() < 8 : value.size() != 8) {
    Fault(absl::StrCat("the state ", Quoted(key), " has ", value.size(), " bytes"));
    return;
  }
  const std::uint64_t number = BigEndian(value.substr(0, 8));
  if (rest == "j") {
    sites_[site].last_sequence = number;
  } else if (rest == "c") {
    sites_[site].checkpoint = number;
  } else if (rest.size() > 3 && rest[0] == 's' && rest[rest.size() - 2] == kEnd) {
    const SessionId id{site, std::string(rest.substr(1, rest.size() - 3))};
    const auto session = sessions_.find(id);
    if (session == sessions_.end()) {
      Fault(absl::StrCat("there is a state of session ", Name(id), ", which is not known"));
      return;
    }
    const auto offset = static_cast<std::int64_t>(number);
    SessionNumbers& numbers = session->second;
    if (rest.back() == 'x') {
      numbers.dropped = true;
      return;
    }
    (rest.back() == 'd'   ? numbers.durable
     : rest.back() == 'p' ? numbers.processed
     : rest.back() == 'h' ? numbers.heard
                          : numbers.state_offset) = offset;
  } else {
    Fault(absl::StrCat("the key ", Quoted(key), " of state is of no kind that is known"));
  }
}

void Check::SeeJournal(std::string_view key, std::string_view value) {
  std::string_view rest;
  const std::string site = TakeSite(key, "journal", &rest);
  if (site.empty()) return;
  if (rest.size() == 9 && rest[0] == 'e') {
    SeeEntry(site, rest.substr(1), value);
  } else if (rest.size() == 17 && rest[0] == 't') {
    SeeTime(site, rest.substr(1));
  } else {
    Fault(absl::StrCat("the key ", Quoted(key), " of the journal is of no kind that is known"));
  }
}

void Check::SeeEntry(const std::string& site, std::string_view sequence, std::string_view value) {
  ++result_.journal_entries;
  SiteNumbers& numbers = sites_[site];
  ++numbers.entries;
  JournalRecord record;
  record.sequence = BigEndian(sequence);
  const std::string where = absl::StrCat("entry ", record.sequence, " of site ", site);
  if (numbers.next_sequence != 0 && record.sequence != numbers.next_sequence) {
    Fault(absl::StrCat(where, " follows where entry ", numbers.next_sequence, " should stand"));
  }
  numbers.next_sequence = record.sequence + 1;
  const absl::Status decoded = DecodeJournalEntry(value, &record);
  if (!decoded.ok()) {
    FaultUnless(decoded, where);
    return;
  }
  const auto session = sessions_.find({site, record.session});
  if (session == sessions_.end()) {
    Fault(absl::StrCat(where, " is of session ", record.session, ", which is not known"));
  } else if (record.entry.offset < 0 || record.entry.offset >= session->second.heard) {
    Fault(absl::StrCat(where, " is of frame ", record.entry.offset, " of session ", record.session,
                       ", of which ", session->second.heard, " frames were heard"));
  }
  const std::string time_key =
      TimeKey(site, record.entry.evidence.stamp_ns) + Number(record.sequence);
  const auto time = view_.Get(Family::kJournal, time_key);
  if (time.ok() && !time->has_value()) Fault(absl::StrCat(where, " is not listed by its time"));
  if (content_.summary) FaultUnless(content_.summary(site, record.entry.summary), where);
}

void Check::SeeTime(const std::string& site, std::string_view stamp_and_sequence) {
  ++sites_[site].times;
  const std::uint64_t sequence = BigEndian(stamp_and_sequence.substr(8));
  const auto entry = view_.Get(Family::kJournal, EntryKey(site, sequence));
  if (entry.ok() && !entry->has_value()) {
    Fault(absl::StrCat("entry ", sequence, " of site ", site, " is listed by time and is missing"));
  }
}

void Check::SeeTile(std::string_view key, std::string_view value) {
  std::string_view rest;
  const std::string site = TakeSite(key, "tiles", &rest);
  if (site.empty()) return;
  ++result_.tiles;
  const auto tile = TileKeyFromBytes(rest);
  if (!tile) {
    Fault(absl::StrCat("a tile of site ", site, " has a key of ", rest.size(),
                       " bytes that is none"));
    return;
  }
  if (content_.tile) {
    const std::string band = tile->band == 0 ? "" : absl::StrCat(" of band ", tile->band);
    FaultUnless(
        content_.tile(site, {*tile, std::string(value)}),
        absl::StrCat("tile ", tile->x, " ", tile->y, " ", tile->z, band, " of site ", site));
  }
}

void Check::SeePose(std::string_view key, std::string_view value) {
  std::string_view rest;
  const std::string site = TakeSite(key, "trajectory", &rest);
  if (site.empty()) return;
  const SessionId id{site, std::string(rest.substr(0, rest.find(kEnd)))};
  if (sessions_.count(id) == 0 || rest.size() != id.session.size() + 9) {
    Fault(absl::StrCat("the pose ", Quoted(key), " is of no session that is known"));
  } else if (content_.pose) {
    FaultUnless(content_.pose(std::string(value)), absl::StrCat("a pose of session ", Name(id)));
  }
}

absl::Status Check::CheckLogs() {
  const std::string logs = data_dir_ + "/sessions";
  std::error_code error;
  for (const auto& site : std::filesystem::directory_iterator(logs, error)) {
    const std::string site_name = site.path().filename().string();
    if (deleted_sites_.count(site_name) != 0) {
      result_.remarks.push_back(
          absl::StrCat(site.path().string(), " is of a deleted site and is still to be removed"));
      continue;
    }
    for (const auto& session : std::filesystem::directory_iterator(site.path(), error)) {
      const SessionId id{site_name, session.path().filename().string()};
      if (sessions_.count(id) == 0) {
        result_.remarks.push_back(
            absl::StrCat(session.path().string(), " is of no session that is known"));
      }
    }
  }
  for (const auto& [id, numbers] : sessions_) {
    const std::string folder = absl::StrCat(logs, "/", id.site, "/", id.session);
    if (numbers.dropped) {
      if (std::filesystem::exists(folder, error)) {
        result_.remarks.push_back(absl::StrCat(folder, " is still to be removed"));
      }
      continue;
    }
    const auto log = CheckSessionLog(folder, std::max(numbers.durable, numbers.processed));
    if (!log.ok()) return log.status();
    result_.segments += log->segments;
    result_.frames += log->frames;
    for (const std::string& fault : log->faults) Fault(fault);
    if (!log->cut_tail.empty()) result_.remarks.push_back(log->cut_tail);
  }
  return absl::OkStatus();
}

void Check::CheckNumbers() {
  for (const auto& [site, numbers] : sites_) {
    const std::string where = absl::StrCat("site ", site);
    const std::uint64_t last = numbers.next_sequence == 0 ? 0 : numbers.next_sequence - 1;
    if (last != numbers.last_sequence) {
      Fault(absl::StrCat(where, ": the journal ends with entry ", last, ", not with ",
                         numbers.last_sequence));
    }
    if (numbers.checkpoint > numbers.last_sequence) {
      Fault(absl::StrCat(where, ": the tiles are of entry ", numbers.checkpoint,
                         ", behind the last one, ", numbers.last_sequence));
    }
    if (numbers.times != numbers.entries) {
      Fault(absl::StrCat(where, ": ", numbers.entries, " entries are listed by ", numbers.times,
                         " times"));
    }
  }
  for (const auto& [id, numbers] : sessions_) {
    if (numbers.heard > numbers.processed || numbers.state_offset > numbers.processed) {
      Fault(absl::StrCat("session ", Name(id), ": processed are ", numbers.processed,
                         " frames, heard ", numbers.heard, ", and the state is after ",
                         numbers.state_offset));
    }
  }
}

absl::StatusOr<DataCheck> Check::Run() {
  using Member = void (Check::*)(std::string_view, std::string_view);
  const std::pair<Family, Member> passes[] = {{Family::kMeta, &Check::SeeRecord},
                                              {Family::kState, &Check::SeeState},
                                              {Family::kJournal, &Check::SeeJournal},
                                              {Family::kTiles, &Check::SeeTile},
                                              {Family::kTrajectory, &Check::SeePose}};
  for (const auto& [family, see] : passes) {
    const absl::Status scanned =
        Scan(family, [this, see = see](std::string_view key, std::string_view value) {
          (this->*see)(key, value);
          return absl::OkStatus();
        });
    if (absl::IsDataLoss(scanned)) {
      Fault(std::string(scanned.message()));
    } else if (!scanned.ok()) {
      return scanned;
    }
  }
  CheckNumbers();
  if (absl::Status checked = CheckLogs(); !checked.ok()) return checked;
  if (unlisted_ > 0)
    result_.faults.push_back(absl::StrCat("there are ", unlisted_, " more faults"));
  result_.sites = static_cast<std::int64_t>(sites_.size());
  result_.sessions = static_cast<std::int64_t>(sessions_.size());
  return result_;
}

}  // namespace

absl::StatusOr<DataCheck> CheckData(const std::string& data_dir, const ContentCheck& content) {
  if (absl::Status format = CheckFormat(data_dir); !format.ok()) {
    return absl::IsNotFound(format)
               ? absl::NotFoundError(absl::StrCat(data_dir, " is not a data folder"))
               : format;
  }
  std::unique_ptr<FileLock> lock;
  if (const std::string path = data_dir + "/LOCK"; std::filesystem::exists(path)) {
    auto acquired = FileLock::Acquire(path);
    if (!acquired.ok()) {
      return absl::FailedPreconditionError(absl::StrCat(
          "the data folder ", data_dir, " is in use by a server: it must stop before the check"));
    }
    lock = *std::move(acquired);
  }
  DatabaseOptions options;
  options.write_buffer_bytes = 64 << 20;
  options.block_cache_bytes = 8 << 20;
  options.max_open_files = 256;
  const auto database = Database::OpenForReading(data_dir + "/db", options);
  if (!database.ok()) return database.status();
  const absl::Status verified = (*database)->VerifyChecksums();
  if (!verified.ok() && !absl::IsDataLoss(verified)) return verified;
  const auto view = (*database)->View();
  if (!view.ok()) return view.status();
  Check check(data_dir, content, *view);
  if (!verified.ok()) check.Fault(std::string(verified.message()));
  return check.Run();
}

}  // namespace soundmap::storage
