#include "building/octree_file.h"

#include <bit>
#include <boost/iostreams/device/array.hpp>
#include <boost/iostreams/stream.hpp>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <optional>
#include <sstream>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::building {
namespace {

constexpr std::string_view kBinaryMagic = "# Octomap OcTree binary file";
constexpr std::string_view kFullMagic = "# Octomap OcTree file";
constexpr std::size_t kMaxHeaderBytes = 4096;
constexpr double kMinVoxelSize_m = 0.005;
constexpr double kMaxVoxelSize_m = 1.0;
constexpr std::uint64_t kMaxNodes = std::uint64_t{1} << 26;  // about 3 GB in OctoMap's nodes
constexpr int kDepth = 16;

absl::string_view View(std::string_view text) { return {text.data(), text.size()}; }

struct Header {
  bool binary = false;
  std::uint64_t nodes = 0;
  double voxel_size_m = 0.0;
  std::size_t data_begin = 0;
};

absl::StatusOr<Header> ParseHeader(std::string_view bytes) {
  Header header;
  std::optional<std::uint64_t> nodes;
  std::optional<double> voxel_size_m;
  bool has_id = false;
  std::size_t begin = 0;
  for (bool first = true;; first = false) {
    const std::size_t end = bytes.substr(0, kMaxHeaderBytes).find('\n', begin);
    if (end == std::string_view::npos) {
      return absl::InvalidArgumentError("the octree's header has no data line");
    }
    const std::string_view line = bytes.substr(begin, end - begin);
    begin = end + 1;
    if (first) {
      header.binary = line.substr(0, kBinaryMagic.size()) == kBinaryMagic;
      if (!header.binary && line.substr(0, kFullMagic.size()) != kFullMagic) {
        return absl::InvalidArgumentError("this is not an OctoMap file");
      }
      continue;
    }
    if (line.empty() || line.front() == '#') continue;
    if (line == "data") break;
    const std::pair<absl::string_view, absl::string_view> field =
        absl::StrSplit(View(line), absl::MaxSplits(' ', 1));
    if (field.first == "id") {
      if (field.second != "OcTree") {
        return absl::InvalidArgumentError(absl::StrCat(
            "the octree's type is '", field.second.substr(0, 40), "'; only OcTree is read"));
      }
      has_id = true;
    } else if (field.first == "size") {
      std::uint64_t value = 0;
      if (!absl::SimpleAtoi(field.second, &value)) {
        return absl::InvalidArgumentError("the octree's size is not a number");
      }
      nodes = value;
    } else if (field.first == "res") {
      double value = 0.0;
      if (!absl::SimpleAtod(field.second, &value)) {
        return absl::InvalidArgumentError("the octree's voxel size (res) is not a number");
      }
      voxel_size_m = value;
    }
  }
  if (!has_id || !nodes || !voxel_size_m) {
    return absl::InvalidArgumentError("the octree's header lacks its id, size or res line");
  }
  if (!(*voxel_size_m >= kMinVoxelSize_m && *voxel_size_m <= kMaxVoxelSize_m)) {
    return absl::InvalidArgumentError(absl::StrCat("the octree's voxel size of ", *voxel_size_m,
                                                   " m is outside ", kMinVoxelSize_m, " to ",
                                                   kMaxVoxelSize_m, " m"));
  }
  if (*nodes == 0) return absl::InvalidArgumentError("the octree has no voxels");
  if (*nodes > kMaxNodes) {
    return absl::InvalidArgumentError(
        absl::StrCat("the octree has ", *nodes, " nodes, more than the limit of ", kMaxNodes));
  }
  header.nodes = *nodes;
  header.voxel_size_m = *voxel_size_m;
  header.data_begin = begin;
  return header;
}

absl::Status Truncated() { return absl::InvalidArgumentError("the octree's data is truncated"); }

absl::Status Damaged() { return absl::InvalidArgumentError("the octree's data is damaged"); }

// Walks the tree in the order of the file, depth first: one entry of `inner_children` for each
// level that is open, with the number of inner nodes of it that are still to come. `read_node`
// returns that number for the next inner node and adds to the count of nodes.
template <typename ReadNode>
absl::Status WalkInnerNodes(const Header& header, ReadNode read_node) {
  std::uint64_t nodes = 1;
  std::vector<int> inner_children = {1};
  while (!inner_children.empty()) {
    if (inner_children.back() == 0) {
      inner_children.pop_back();
      continue;
    }
    --inner_children.back();
    // The root is at depth 0, and what is read here at the depth of the open levels above it.
    const absl::StatusOr<int> below = read_node(static_cast<int>(inner_children.size()) - 1, nodes);
    if (!below.ok()) return below.status();
    if (nodes > header.nodes) return Damaged();
    inner_children.push_back(*below);
  }
  return nodes == header.nodes ? absl::OkStatus() : Damaged();
}

// `.bt`: two bits for each of an inner node's children: 00 unknown, 01 free, 10 occupied, 11 inner.
absl::Status CheckBinaryData(const Header& header, std::string_view data) {
  std::size_t position = 0;
  return WalkInnerNodes(header, [&](int depth, std::uint64_t& nodes) -> absl::StatusOr<int> {
    if (depth >= kDepth) return Damaged();
    if (data.size() - position < 2) return Truncated();
    const unsigned children = static_cast<unsigned char>(data[position]) |
                              static_cast<unsigned char>(data[position + 1]) << 8;
    position += 2;
    if (children == 0) return Damaged();
    const unsigned low = children & 0x5555u;
    const unsigned high = children >> 1 & 0x5555u;
    nodes += std::popcount(low | high);
    return std::popcount(low & high);
  });
}

// `.ot`: each node's log-odds as float, then a bit for each child that exists.
absl::Status CheckFullData(const Header& header, std::string_view data) {
  std::size_t position = 0;
  return WalkInnerNodes(header, [&](int depth, std::uint64_t& nodes) -> absl::StatusOr<int> {
    if (data.size() - position < 5) return Truncated();
    float log_odds;
    std::memcpy(&log_odds, data.data() + position, sizeof log_odds);
    const unsigned children = static_cast<unsigned char>(data[position + 4]);
    position += 5;
    if (!std::isfinite(log_odds)) {
      return absl::InvalidArgumentError("the octree has log-odds that are not finite");
    }
    if (children != 0 && depth >= kDepth) return Damaged();
    nodes += std::popcount(children);
    return std::popcount(children);
  });
}

// As OctoMap's write() and writeBinaryConst(), which report to standard error and shorten the voxel
// size to six digits.
std::string HeaderText(std::string_view magic, const octomap::OcTree& octree) {
  char voxel_size_m[32];
  const auto [end, error] =
      std::to_chars(voxel_size_m, std::end(voxel_size_m), octree.getResolution());
  return absl::StrCat(View(magic),
                      "\n# (feel free to add / change comments, but leave the first line as it is!)"
                      "\n#\nid OcTree\nsize ",
                      octree.size(), "\nres ", absl::string_view(voxel_size_m, end - voxel_size_m),
                      "\ndata\n");
}

}  // namespace

absl::StatusOr<std::shared_ptr<octomap::OcTree>> ParseOctree(std::string_view bytes) {
  const absl::StatusOr<Header> header = ParseHeader(bytes);
  if (!header.ok()) return header.status();
  const std::string_view data = bytes.substr(header->data_begin);
  const absl::Status checked =
      header->binary ? CheckBinaryData(*header, data) : CheckFullData(*header, data);
  if (!checked.ok()) return checked;

  auto octree = std::make_shared<octomap::OcTree>(header->voxel_size_m);
  boost::iostreams::stream<boost::iostreams::array_source> stream(data.data(), data.size());
  if (header->binary) {
    octree->readBinaryData(stream);
  } else {
    octree->readData(stream);
    octree->updateInnerOccupancy();
  }
  if (octree->size() != header->nodes) return Damaged();
  return octree;
}

std::string OctreeToBt(const octomap::OcTree& octree) {
  std::ostringstream stream;
  stream << HeaderText(kBinaryMagic, octree);
  octree.writeBinaryData(stream);
  return std::move(stream).str();
}

std::string OctreeToOt(const octomap::OcTree& octree) {
  std::ostringstream stream;
  stream << HeaderText(kFullMagic, octree);
  octree.writeData(stream);
  return std::move(stream).str();
}

}  // namespace soundmap::building
