#include <gtest/gtest.h>

#include <map>
#include <random>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "storage/frame_sequence.h"
#include "storage/store.h"

namespace soundmap::storage {
namespace {

// What a store must hold, in maps.
struct Model {
  struct Session {
    std::int64_t received = 0;
    std::int64_t durable = 0;
    std::int64_t processed = 0;
    std::int64_t heard = 0;
    std::optional<std::int64_t> state_offset;
    std::map<std::int64_t, std::string> poses;
  };
  struct Site {
    std::map<std::string, Session> sessions;
    std::vector<std::pair<std::string, std::int64_t>> journal;  // session, offset
    std::map<TileKey, std::string> tiles;
    std::uint64_t checkpoint = 0;
  };
  std::map<std::string, Site> sites;
  std::map<std::pair<Table, std::string>, std::string> records;
};

class StoreModel : public ::testing::TestWithParam<int> {
 protected:
  std::uint64_t Draw(std::uint64_t bound) { return random_() % bound; }
  std::string Site() { return "site" + std::string(Draw(3), '-'); }
  std::string Session() { return absl::StrCat("s", Draw(3)); }
  std::string Key() { return absl::StrCat(Site(), "/", Draw(4)); }
  Table DrawTable() { return static_cast<Table>(1 + Draw(6)); }

  void Reopen() {
    store_.reset();
    auto store = Store::Open(folder_, options_);
    ASSERT_TRUE(store.ok()) << store.status();
    store_ = *std::move(store);
    for (auto& [site_name, site] : model_.sites) {
      for (auto& [name, session] : site.sessions) session.durable = session.received;
    }
  }

  void Append() {
    const SessionId id{Site(), Session()};
    auto log = store_->OpenSession(id).value();
    Model::Session& session = model_.sites[id.site].sessions[id.session];
    for (std::uint64_t i = Draw(15); i > 0; --i) {
      ASSERT_EQ(log->Append(FrameAt(session.received)).value(), session.received);
      ++session.received;
    }
    if (Draw(3) > 0) {
      ASSERT_EQ(log->Sync().value(), session.received);
      session.durable = session.received;
    }
  }

  void Process() {
    const SessionId id{Site(), Session()};
    Model::Site& site = model_.sites[id.site];
    Model::Session& session = site.sessions[id.session];
    const std::int64_t backlog = session.durable - session.processed;
    Commit commit{id.site, id.session, 0, 0, {}, {}, {}};
    commit.processed_offset = session.processed + static_cast<std::int64_t>(Draw(backlog + 1));
    // A lost robot's sound waits; later commits bring it.
    commit.heard_offset = session.heard + static_cast<std::int64_t>(
                                              Draw(commit.processed_offset - session.heard + 1));
    for (std::int64_t offset = session.heard; offset < commit.heard_offset; ++offset) {
      if (Draw(4) != 0) continue;
      commit.journal.push_back(EntryAt(offset));
      site.journal.emplace_back(id.session, offset);
      const auto time_ns = static_cast<std::int64_t>(Draw(40)) - 20;
      commit.trajectory.push_back({time_ns, std::to_string(Draw(1000))});
      session.poses[time_ns] = commit.trajectory.back().pose;
    }
    if (Draw(3) == 0) {
      commit.state = StateAt(commit.processed_offset);
      session.state_offset = commit.processed_offset;
    }
    session.processed = commit.processed_offset;
    session.heard = commit.heard_offset;
    ASSERT_EQ(store_->CommitBatch(commit).value(), site.journal.size());
  }

  void Checkpoint() {
    const std::string name = Site();
    Model::Site& site = model_.sites[name];
    site.checkpoint += Draw(site.journal.size() - site.checkpoint + 1);
    std::vector<Tile> tiles;
    for (std::uint64_t i = Draw(4); i > 0; --i) {
      const auto axis = [this] { return static_cast<std::uint16_t>(254 + Draw(4)); };
      const TileKey key{axis(), axis(), axis(), static_cast<std::uint8_t>(Draw(3))};
      tiles.push_back({key, std::string(Draw(3) * 100, static_cast<char>('a' + Draw(26)))});
      if (tiles.back().bytes.empty()) {
        site.tiles.erase(key);
      } else {
        site.tiles[key] = tiles.back().bytes;
      }
    }
    ASSERT_TRUE(store_->PutCheckpoint(name, tiles, site.checkpoint).ok());
  }

  void Compare() {
    for (int table = 1; table <= 6; ++table) {
      const auto listed = store_->ListRecords(static_cast<Table>(table), "").value();
      std::map<std::pair<Table, std::string>, std::string> found;
      for (const Record& record : listed) {
        found[{static_cast<Table>(table), record.key}] = record.bytes;
      }
      std::map<std::pair<Table, std::string>, std::string> expected;
      for (const auto& [key, bytes] : model_.records) {
        if (key.first == static_cast<Table>(table)) expected[key] = bytes;
      }
      ASSERT_EQ(found, expected);
    }
    for (const std::string name : {"site", "site-", "site--"})
      CompareSite(name, model_.sites[name]);
  }

  void CompareSite(const std::string& name, Model::Site& site) {
    std::size_t entries = 0;
    const auto read = store_->ReadJournal(name, 1, [&](const JournalRecord& record) {
      EXPECT_EQ(record.sequence, entries + 1);
      if (entries < site.journal.size()) {
        const auto& [session, offset] = site.journal[entries];
        EXPECT_EQ(record.session, session);
        EXPECT_EQ(record.entry.offset, offset);
        EXPECT_EQ(record.entry.summary, EntryAt(offset).summary);
        EXPECT_EQ(record.entry.evidence, EntryAt(offset).evidence);
      }
      ++entries;
      return absl::OkStatus();
    });
    ASSERT_TRUE(read.ok()) << read;
    ASSERT_EQ(entries, site.journal.size());
    ASSERT_EQ(store_->LastSequence(name).value(), site.journal.size());

    std::map<TileKey, std::string> tiles;
    const auto checkpoint = store_->ReadTiles(name, [&](const Tile& tile) {
      tiles[tile.key] = tile.bytes;
      return absl::OkStatus();
    });
    ASSERT_EQ(checkpoint.value(), site.checkpoint);
    ASSERT_EQ(tiles, site.tiles);
    for (auto& [session_name, session] : site.sessions) {
      CompareSession({name, session_name}, session);
    }
  }

  void CompareSession(const SessionId& id, const Model::Session& session) {
    ASSERT_EQ(store_->ProcessedOffset(id).value(), session.processed);
    ASSERT_EQ(store_->HeardOffset(id).value(), session.heard);
    const auto state = store_->LatestState(id).value();
    ASSERT_EQ(state.has_value(), session.state_offset.has_value());
    if (state) {
      EXPECT_EQ(state->offset, *session.state_offset);
      EXPECT_EQ(state->state, StateAt(state->offset).state);
    }
    std::map<std::int64_t, std::string> poses;
    ASSERT_TRUE(store_
                    ->ReadTrajectory(id, -1000, 1000,
                                     [&](const TrajectoryEntry& entry) {
                                       poses[entry.time_ns] = entry.pose;
                                       return absl::OkStatus();
                                     })
                    .ok());
    ASSERT_EQ(poses, session.poses);

    auto log = store_->OpenSession(id).value();
    ASSERT_EQ(log->received(), session.received);
    ASSERT_EQ(log->durable(), session.durable);
    std::int64_t offset = static_cast<std::int64_t>(Draw(session.durable + 1));
    auto reader = log->Read(offset).value();
    for (auto frame = reader->Next().value(); frame; frame = reader->Next().value(), ++offset) {
      ASSERT_EQ(frame->data, FrameAt(offset).data);
    }
    ASSERT_EQ(offset, session.durable);
  }

  std::mt19937_64 random_{static_cast<std::uint64_t>(GetParam())};
  const std::string folder_ = EmptyFolder("model");
  StoreOptions options_ = [] {
    StoreOptions options;
    options.session_log.segment_bytes = 4000;
    return options;
  }();
  std::unique_ptr<Store> store_;
  Model model_;
};

TEST_P(StoreModel, HoldsWhatPlainMapsHold) {
  Reopen();
  for (int step = 0; step < 200 && !HasFatalFailure(); ++step) {
    switch (Draw(12)) {
      case 0: {
        const Table table = DrawTable();
        const std::string key = Key();
        ASSERT_TRUE(store_->DeleteRecord(table, key).ok());
        model_.records.erase({table, key});
        break;
      }
      case 1: {
        const Table table = DrawTable();
        const std::string key = Key();
        const std::string bytes(Draw(50), 'r');
        ASSERT_TRUE(store_->PutRecord(table, key, bytes).ok());
        model_.records[{table, key}] = bytes;
        break;
      }
      case 2:
      case 3:
      case 4:
      case 5:
        Append();
        break;
      case 6:
      case 7:
      case 8:
        Process();
        break;
      case 9:
        Checkpoint();
        break;
      case 10:
        if (Draw(4) == 0) {
          Reopen();
        } else {
          const SessionId id{Site(), Session()};
          ASSERT_TRUE(store_->CloseSession(id).ok());
          Model::Session& session = model_.sites[id.site].sessions[id.session];
          session.durable = session.received;
        }
        break;
      case 11:
        if (Draw(8) == 0) {
          const std::string site = Site();
          ASSERT_TRUE(store_->DeleteSite(site).ok());
          model_.sites.erase(site);
          std::erase_if(model_.records, [&site](const auto& record) {
            return record.first.first <= Table::kOperation &&
                   record.first.second.starts_with(site + "/");
          });
        }
        break;
    }
    if (step % 25 == 0) Compare();
  }
  Reopen();
  Compare();
}

INSTANTIATE_TEST_SUITE_P(Seeds, StoreModel, ::testing::Range(1, 5));

}  // namespace
}  // namespace soundmap::storage
