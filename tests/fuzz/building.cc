#include "building/building.h"

#include "building/files.h"
#include "building/stored_building.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

using building::MapFormat;
constexpr MapFormat kFormats[] = {MapFormat::kBt, MapFormat::kOt, MapFormat::kPly, MapFormat::kPcd,
                                  MapFormat::kRosYaml};
constexpr char kBetweenFiles = '\n';

}  // namespace

// The first byte is the format; 5: a building as it is stored.
std::vector<std::string> Seeds() {
  std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 40\nproperty float x\nproperty float y\nproperty "
      "float "
      "z\nend_header\n";
  std::string pcd =
      "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 40\nHEIGHT "
      "1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 40\nDATA ascii\n";
  for (int i = 0; i < 40; ++i) {
    const std::string point = std::to_string(0.05 * i) + " 0 " + std::to_string(0.05 * (i % 10));
    ply += point + "\n";
    pcd += point + "\n";
  }
  std::vector<std::string> seeds = {
      std::string(1, '\2') + ply, std::string(1, '\3') + pcd,
      std::string(1, '\4') +
          "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: "
          "0.65\nfree_thresh: 0.196\n\n" +
          "P5\n4 4\n255\n" + std::string(16, '\0')};
  const auto building = building::ImportBuilding(MapFormat::kPly, ply, "", {});
  Require(building.ok());
  seeds.push_back(std::string(1, '\0') + *building::ExportGeometry(*building, MapFormat::kBt));
  seeds.push_back(std::string(1, '\1') + *building::ExportGeometry(*building, MapFormat::kOt));
  seeds.push_back(std::string(1, '\5') + building::SerializeBuilding(*building));
  return seeds;
}

void Decode(std::string_view bytes) {
  if (bytes.empty()) return;
  const int kind = static_cast<unsigned char>(bytes[0]) % 6;
  bytes.remove_prefix(1);
  if (kind == 5) {
    const auto building = building::ParseBuilding(bytes);
    if (building.ok()) Require(building::ParseBuilding(SerializeBuilding(*building)).ok());
    return;
  }
  // A ROS map has its picture behind an empty line.
  const std::size_t gap = bytes.find(std::string(2, kBetweenFiles));
  const std::string_view picture =
      gap == std::string_view::npos ? std::string_view() : bytes.substr(gap + 2);
  const auto building = building::ImportBuilding(
      kFormats[kind], bytes.substr(0, kind == 4 ? gap : bytes.npos), picture, {});
  if (building.ok()) Require(building::ParseBuilding(SerializeBuilding(*building)).ok());
}

}  // namespace soundmap::fuzz
