#pragma once

#include <octomap/OcTreeNode.h>
#include <octomap/OccupancyOcTreeBase.h>

#include <cstdint>
#include <iosfwd>
#include <string>

namespace soundmap::sound_map {

// A node of the sound map as an OctoMap octree. Log-odds stand where OctoMap keeps its own, so that
// its tools colour them. An inner node holds the largest log-odds and update count and the latest
// update of its children. On the stream, little-endian: f32 log-odds L, u32 update count M, i64
// last update U in ns since the Unix epoch, then u8: bit i says that child i exists and follows, as
// in every .ot file.
class SoundOcTreeNode : public octomap::OcTreeNode {
 public:
  bool operator==(const SoundOcTreeNode& other) const {
    return value == other.value && update_count == other.update_count &&
           last_update_ns == other.last_update_ns;
  }
  void copyData(const SoundOcTreeNode& from);
  std::istream& readData(std::istream& stream);
  std::ostream& writeData(std::ostream& stream) const;

  std::uint32_t update_count = 0;
  std::int64_t last_update_ns = 0;
};

// The sound map with L, M and U as an .ot file of the type "SoundOcTree". A program that links this
// class reads it with octomap::AbstractOcTree::read. Voxels are never merged: each keeps its own
// count and time.
class SoundOcTree : public octomap::OccupancyOcTreeBase<SoundOcTreeNode> {
 public:
  explicit SoundOcTree(double voxel_size_m);
  SoundOcTree* create() const override { return new SoundOcTree(resolution); }
  std::string getTreeType() const override { return "SoundOcTree"; }
  bool isNodeCollapsible(const SoundOcTreeNode*) const override { return false; }

  // Sets the inner nodes from their children.
  void UpdateInnerNodes();

 private:
  void UpdateInnerNode(SoundOcTreeNode* node);

  class Registration {
   public:
    Registration();
    void EnsureLinking() {}
  };
  static Registration registration_;
};

}  // namespace soundmap::sound_map
