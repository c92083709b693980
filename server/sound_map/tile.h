#pragma once

#include <array>
#include <atomic>
#include <boost/smart_ptr/intrusive_ptr.hpp>
#include <boost/unordered/unordered_flat_map.hpp>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/functional/function_ref.h"
#include "sound_map/voxel.h"

namespace soundmap::sound_map {

// Copy-on-write by generation: an object belongs to the writer alone while its generation is the
// map's present one. A snapshot raises the map's generation, and from then on the writer copies
// what it wants to change. Nothing that a reader can see is ever written.
using Generation = std::uint64_t;

// 8^3 voxels: a bit for each that exists, and the existing ones packed in the order of their bits
// (x fastest).
class Block {
 public:
  static constexpr int kBits = 3;
  static constexpr int kVoxels = 512;

  // The last update as an index into the tile's stamps: two bytes where the time itself would take
  // eight.
  struct [[gnu::packed]] Cell {
    float log_odds;
    std::uint32_t update_count;
    std::uint16_t stamp;
  };

  static boost::intrusive_ptr<Block> Create(Generation generation, int capacity);
  boost::intrusive_ptr<Block> Copy(Generation generation, int capacity) const;

  Generation generation() const { return generation_; }
  int size() const { return size_; }
  int capacity() const { return capacity_; }
  const std::uint64_t* mask() const { return mask_; }

  bool Has(int voxel) const { return (mask_[voxel >> 6] >> (voxel & 63)) & 1; }
  // Where the cell of a voxel stands or would stand.
  int Rank(int voxel) const {
    const std::uint64_t below = mask_[voxel >> 6] & ((std::uint64_t{1} << (voxel & 63)) - 1);
    return rank_[voxel >> 6] + BitCount(below);
  }
  Cell& at(int rank) { return reinterpret_cast<Cell*>(this + 1)[rank]; }
  const Cell& at(int rank) const { return reinterpret_cast<const Cell*>(this + 1)[rank]; }

  // A zero cell for a voxel that does not exist yet; there must be room.
  Cell& Insert(int voxel);

  std::size_t memory_bytes() const { return sizeof(Block) + capacity_ * sizeof(Cell); }

 private:
  friend void intrusive_ptr_add_ref(const Block* block) {
    block->references_.fetch_add(1, std::memory_order_relaxed);
  }
  friend void intrusive_ptr_release(const Block* block) {
    if (block->references_.fetch_sub(1, std::memory_order_acq_rel) == 1) Destroy(block);
  }
  static void Destroy(const Block* block);

  // Plain x86-64 has no instruction for it, and the compiler's replacement is a call.
  static int BitCount(std::uint64_t bits) {
    bits -= (bits >> 1) & 0x5555555555555555u;
    bits = (bits & 0x3333333333333333u) + ((bits >> 2) & 0x3333333333333333u);
    bits = (bits + (bits >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return static_cast<int>((bits * 0x0101010101010101u) >> 56);
  }

  Block(Generation generation, int capacity)
      : capacity_(static_cast<std::uint16_t>(capacity)), generation_(generation) {}

  mutable std::atomic<std::uint32_t> references_{0};
  std::uint16_t size_ = 0;
  std::uint16_t capacity_;
  Generation generation_;
  std::uint16_t rank_[8] = {};  // existing voxels in the words before
  std::uint64_t mask_[8] = {};  // word z, bit x + 8 y
};

using SupportTable = boost::unordered_flat_map<std::uint16_t, Support>;  // by voxel in the tile

// 32^3 voxels as 4^3 blocks. A voxel in its tile has the number block * 512 + voxel in the block, x
// fastest in both.
class Tile {
 public:
  static constexpr int kBlocks = 64;
  static constexpr int kVoxels = kBlocks * Block::kVoxels;

  Tile(TileKey key, Generation generation) : key_(key), generation_(generation) {}
  Tile(const Tile& other, Generation generation);

  static int BlockOf(const geometry::VoxelKey& key) {
    return ((key.x >> 3) & 3) | ((key.y >> 3) & 3) << 2 | ((key.z >> 3) & 3) << 4;
  }
  static int VoxelOf(const geometry::VoxelKey& key) {
    return (key.x & 7) | (key.y & 7) << 3 | (key.z & 7) << 6;
  }
  geometry::VoxelKey KeyOf(int block, int voxel) const;

  TileKey key() const { return key_; }
  Generation generation() const { return generation_; }
  std::uint64_t revision() const { return revision_; }
  int voxel_count() const { return voxel_count_; }
  const Block* block(int index) const { return blocks_[index].get(); }
  frames::TimeNs stamp(int index) const { return stamps_[index]; }
  const SupportTable& support() const;
  Voxel VoxelAt(const Block& block, int rank) const;
  std::optional<Voxel> Find(const geometry::VoxelKey& key) const;
  // In the order of the numbers; stops when the visitor returns false, and returns whether it did
  // not.
  bool ForEach(absl::FunctionRef<bool(const geometry::VoxelKey&, const Voxel&)> visit) const;
  std::size_t memory_bytes() const;

  // The rest is for the writer, on a tile of the map's present generation.
  void set_revision(std::uint64_t revision) { revision_ = revision; }
  // The index of a time to be given to cells until the next call. May renumber, so that stamps
  // without a cell do not pile up.
  std::uint16_t AddStamp(frames::TimeNs stamp_ns);
  // The cell of a voxel, made if need be.
  Block::Cell& Touch(int block, int voxel) {
    Block* present = blocks_[block].get();
    if (present != nullptr && present->generation() == generation_ && present->Has(voxel)) {
      return present->at(present->Rank(voxel));
    }
    return TouchSlowly(block, voxel);
  }
  void AddSupport(int voxel_in_tile, frames::TimeNs stamp_ns);
  SupportTable& MutableSupport();
  // All stamps at once, for cells that already hold their indices.
  void SetStamps(std::vector<frames::TimeNs> stamps);

 private:
  Block::Cell& TouchSlowly(int block, int voxel);
  Block& MutableBlock(int index, int capacity);

  TileKey key_;
  Generation generation_;
  std::uint64_t revision_ = 0;  // the map's revision at the last change
  int voxel_count_ = 0;
  std::size_t stamp_limit_ = 64;  // renumber when reached
  std::vector<frames::TimeNs> stamps_;
  std::shared_ptr<SupportTable> support_;  // null: empty
  Generation support_generation_ = 0;
  std::array<boost::intrusive_ptr<Block>, kBlocks> blocks_;
};

}  // namespace soundmap::sound_map
