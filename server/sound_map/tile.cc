#include "sound_map/tile.h"

#include <algorithm>
#include <cstring>
#include <new>

namespace soundmap::sound_map {
namespace {

// Room for some voxels more: surfaces grow by rows, and an exact fit would be copied at every
// voxel.
int GrownCapacity(int size) { return std::min(size + size / 8 + 4, Block::kVoxels); }

}  // namespace

boost::intrusive_ptr<Block> Block::Create(Generation generation, int capacity) {
  void* memory = ::operator new(sizeof(Block) + capacity * sizeof(Cell));
  return boost::intrusive_ptr<Block>(new (memory) Block(generation, capacity));
}

boost::intrusive_ptr<Block> Block::Copy(Generation generation, int capacity) const {
  auto copy = Create(generation, capacity);
  copy->size_ = size_;
  std::memcpy(copy->rank_, rank_, sizeof(rank_));
  std::memcpy(copy->mask_, mask_, sizeof(mask_));
  std::memcpy(static_cast<void*>(&copy->at(0)), &at(0), size_ * sizeof(Cell));
  return copy;
}

void Block::Destroy(const Block* block) {
  block->~Block();
  ::operator delete(const_cast<Block*>(block));
}

Block::Cell& Block::Insert(int voxel) {
  const int rank = Rank(voxel);
  std::memmove(static_cast<void*>(&at(rank) + 1), &at(rank), (size_ - rank) * sizeof(Cell));
  mask_[voxel >> 6] |= std::uint64_t{1} << (voxel & 63);
  for (int word = (voxel >> 6) + 1; word < 8; ++word) ++rank_[word];
  ++size_;
  at(rank) = Cell{0.0f, 0, 0};
  return at(rank);
}

Tile::Tile(const Tile& other, Generation generation)
    : key_(other.key_),
      generation_(generation),
      revision_(other.revision_),
      voxel_count_(other.voxel_count_),
      stamp_limit_(other.stamp_limit_),
      stamps_(other.stamps_),
      support_(other.support_),
      support_generation_(other.support_generation_),
      blocks_(other.blocks_) {}

geometry::VoxelKey Tile::KeyOf(int block, int voxel) const {
  return {static_cast<std::uint16_t>(key_.x << 5 | (block & 3) << 3 | (voxel & 7)),
          static_cast<std::uint16_t>(key_.y << 5 | (block >> 2 & 3) << 3 | (voxel >> 3 & 7)),
          static_cast<std::uint16_t>(key_.z << 5 | (block >> 4 & 3) << 3 | (voxel >> 6 & 7))};
}

const SupportTable& Tile::support() const {
  static const SupportTable kEmpty;
  return support_ ? *support_ : kEmpty;
}

Voxel Tile::VoxelAt(const Block& block, int rank) const {
  const Block::Cell cell = block.at(rank);
  return {cell.log_odds, cell.update_count, stamps_[cell.stamp]};
}

std::optional<Voxel> Tile::Find(const geometry::VoxelKey& key) const {
  const Block* block = blocks_[BlockOf(key)].get();
  const int voxel = VoxelOf(key);
  if (block == nullptr || !block->Has(voxel)) return std::nullopt;
  return VoxelAt(*block, block->Rank(voxel));
}

bool Tile::ForEach(absl::FunctionRef<bool(const geometry::VoxelKey&, const Voxel&)> visit) const {
  for (int b = 0; b < kBlocks; ++b) {
    const Block* block = blocks_[b].get();
    if (block == nullptr) continue;
    int rank = 0;
    for (int word = 0; word < 8; ++word) {
      for (std::uint64_t rest = block->mask()[word]; rest != 0; rest &= rest - 1, ++rank) {
        const int voxel = word * 64 + __builtin_ctzll(rest);
        if (!visit(KeyOf(b, voxel), VoxelAt(*block, rank))) return false;
      }
    }
  }
  return true;
}

std::size_t Tile::memory_bytes() const {
  std::size_t bytes = sizeof(Tile) + stamps_.capacity() * sizeof(frames::TimeNs);
  if (support_) {
    bytes +=
        support_->bucket_count() * (sizeof(SupportTable::value_type) + 1) + sizeof(SupportTable);
  }
  for (const auto& block : blocks_) {
    if (block) bytes += block->memory_bytes();
  }
  return bytes;
}

std::uint16_t Tile::AddStamp(frames::TimeNs stamp_ns) {
  if (!stamps_.empty() && stamps_.back() == stamp_ns) {
    return static_cast<std::uint16_t>(stamps_.size() - 1);
  }
  if (stamps_.size() >= stamp_limit_) {
    std::vector<char> used(stamps_.size(), 0);
    for (const auto& block : blocks_) {
      for (int rank = 0; block && rank < block->size(); ++rank) used[block->at(rank).stamp] = 1;
    }
    std::vector<std::uint16_t> renumbered(stamps_.size(), 0);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < stamps_.size(); ++i) {
      if (used[i] == 0) continue;
      renumbered[i] = static_cast<std::uint16_t>(kept);
      stamps_[kept++] = stamps_[i];
    }
    stamps_.resize(kept);
    for (int b = 0; b < kBlocks; ++b) {
      if (!blocks_[b]) continue;
      Block& block = MutableBlock(b, blocks_[b]->size());
      for (int rank = 0; rank < block.size(); ++rank) {
        block.at(rank).stamp = renumbered[block.at(rank).stamp];
      }
    }
    // At most one stamp a voxel is in use, 32768 in all: the index never leaves 16 bits.
    stamp_limit_ = kept + kept / 4 + 64;
    stamps_.reserve(stamp_limit_);
  }
  stamps_.push_back(stamp_ns);
  return static_cast<std::uint16_t>(stamps_.size() - 1);
}

void Tile::SetStamps(std::vector<frames::TimeNs> stamps) {
  stamps_ = std::move(stamps);
  stamp_limit_ = stamps_.size() + stamps_.size() / 4 + 64;
}

Block& Tile::MutableBlock(int index, int capacity) {
  auto& block = blocks_[index];
  if (!block) {
    block = Block::Create(generation_, std::max(capacity, 8));
  } else if (block->generation() != generation_ || block->capacity() < capacity) {
    block = block->Copy(generation_, std::max<int>(capacity, block->capacity()));
  }
  return *block;
}

Block::Cell& Tile::TouchSlowly(int index, int voxel) {
  const Block* present = blocks_[index].get();
  if (present != nullptr && present->Has(voxel)) {
    Block& block = MutableBlock(index, present->capacity());
    return block.at(block.Rank(voxel));
  }
  const int size = present == nullptr ? 0 : present->size();
  const bool room = present != nullptr && size < present->capacity();
  Block& block = MutableBlock(index, room ? present->capacity() : GrownCapacity(size));
  ++voxel_count_;
  return block.Insert(voxel);
}

SupportTable& Tile::MutableSupport() {
  if (!support_ || support_generation_ != generation_) {
    support_ =
        support_ ? std::make_shared<SupportTable>(*support_) : std::make_shared<SupportTable>();
    support_generation_ = generation_;
  }
  return *support_;
}

void Tile::AddSupport(int voxel_in_tile, frames::TimeNs stamp_ns) {
  auto [entry, is_new] = MutableSupport().try_emplace(static_cast<std::uint16_t>(voxel_in_tile),
                                                      Support{stamp_ns, stamp_ns, 0});
  Support& support = entry->second;
  support.first_heard_ns = std::min(support.first_heard_ns, stamp_ns);
  support.last_heard_ns = std::max(support.last_heard_ns, stamp_ns);
  if (support.count != UINT32_MAX) ++support.count;
}

}  // namespace soundmap::sound_map
