#include "sound_map/sound_octree.h"

#include <algorithm>
#include <istream>
#include <limits>
#include <ostream>

namespace soundmap::sound_map {
namespace {

template <typename T>
void Read(std::istream& stream, T& value) {
  stream.read(reinterpret_cast<char*>(&value), sizeof(value));
}

template <typename T>
void Write(std::ostream& stream, const T& value) {
  stream.write(reinterpret_cast<const char*>(&value), sizeof(value));
}

}  // namespace

void SoundOcTreeNode::copyData(const SoundOcTreeNode& from) {
  OcTreeNode::copyData(from);
  update_count = from.update_count;
  last_update_ns = from.last_update_ns;
}

std::istream& SoundOcTreeNode::readData(std::istream& stream) {
  Read(stream, value);
  Read(stream, update_count);
  Read(stream, last_update_ns);
  return stream;
}

std::ostream& SoundOcTreeNode::writeData(std::ostream& stream) const {
  Write(stream, value);
  Write(stream, update_count);
  Write(stream, last_update_ns);
  return stream;
}

SoundOcTree::Registration SoundOcTree::registration_;

SoundOcTree::Registration::Registration() {
  auto* prototype = new SoundOcTree(0.1);  // OctoMap's registry keeps it
  prototype->clearKeyRays();
  octomap::AbstractOcTree::registerTreeType(prototype);
}

SoundOcTree::SoundOcTree(double voxel_size_m)
    : octomap::OccupancyOcTreeBase<SoundOcTreeNode>(voxel_size_m) {
  registration_.EnsureLinking();
}

void SoundOcTree::UpdateInnerNodes() {
  if (root != nullptr) UpdateInnerNode(root);
}

void SoundOcTree::UpdateInnerNode(SoundOcTreeNode* node) {
  if (!nodeHasChildren(node)) return;
  float log_odds = -std::numeric_limits<float>::infinity();
  node->update_count = 0;
  node->last_update_ns = std::numeric_limits<std::int64_t>::min();
  for (unsigned i = 0; i < 8; ++i) {
    if (!nodeChildExists(node, i)) continue;
    SoundOcTreeNode* child = getNodeChild(node, i);
    UpdateInnerNode(child);
    log_odds = std::max(log_odds, child->getLogOdds());
    node->update_count = std::max(node->update_count, child->update_count);
    node->last_update_ns = std::max(node->last_update_ns, child->last_update_ns);
  }
  node->setLogOdds(log_odds);
}

}  // namespace soundmap::sound_map
