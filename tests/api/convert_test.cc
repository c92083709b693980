#include "api/convert.h"

#include <gtest/gtest.h>

namespace soundmap::api {
namespace {

TEST(Convert, ASourceTellsWhereItMayBeInstead) {
  sound_map::RegisteredSource source;
  source.found.position_in_map_m = {1.0, 2.0, 1.9};
  EXPECT_FALSE(ToProto("hall", "", source).has_mirror_position_m());
  source.mirror_in_map_m = Eigen::Vector3d(1.25, 2.5, 0.5);
  const v1::SoundSource proto = ToProto("hall", "", source);
  EXPECT_EQ(proto.position_m().z(), 1.9);
  EXPECT_EQ(proto.mirror_position_m().x(), 1.25);
  EXPECT_EQ(proto.mirror_position_m().y(), 2.5);
  EXPECT_EQ(proto.mirror_position_m().z(), 0.5);
  sound_map::SourceEvent event;
  event.source = source;
  EXPECT_EQ(ToProto("hall", "", event).sound_source().mirror_position_m().z(), 0.5);
}

TEST(Convert, ASourceTellsWhatExplainsIt) {
  sound_map::RegisteredSource source;
  EXPECT_EQ(ToProto("hall", "", source).explained_by(), "");
  source.explained_by_id = 0x1f;
  EXPECT_EQ(ToProto("hall", "", source).explained_by(), "sites/hall/soundSources/000000000000001f");
  EXPECT_EQ(ToProto("hall", "hiss", source).explained_by(),
            "sites/hall/soundSources/hiss-000000000000001f");
}

}  // namespace
}  // namespace soundmap::api
