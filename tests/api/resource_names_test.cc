#include "api/resource_names.h"

#include <gtest/gtest.h>

namespace soundmap::api {
namespace {

TEST(ResourceNames, AreReadBackAsTheyWereWritten) {
  const auto session = ParseSession(SessionResource("hall", "r-1"));
  ASSERT_TRUE(session.ok()) << session.status();
  EXPECT_EQ(session->site, "hall");
  EXPECT_EQ(session->session, "r-1");
  EXPECT_EQ(ParseSite(SiteResource("hall")).value(), "hall");
  EXPECT_EQ(ParseRobot(RobotResource("r2")).value(), "r2");
  EXPECT_EQ(ParseOperation(OperationResource("7")).value(), "7");
  EXPECT_EQ(ParseSoundSource(SoundSourceResource("hall", "0f"))->source, "0f");
  EXPECT_EQ(ParseSoundSource(SoundSourceResource("hall", "0f"))->band, "");
  const auto of_band = ParseSoundSource(SoundSourceResource("hall", "hiss-high-0f"));
  EXPECT_EQ(of_band->band, "hiss-high");
  EXPECT_EQ(of_band->source, "hiss-high-0f");
}

TEST(ResourceNames, OtherFormsAreRefused) {
  for (const char* name : {"", "hall", "sites", "sites/", "sites/a/b", "robots/hall", "/sites/hall",
                           "sites/hall/", "sites//sessions/x"}) {
    EXPECT_EQ(ParseSite(name).status().code(), absl::StatusCode::kInvalidArgument) << name;
  }
  EXPECT_FALSE(ParseSession("sites/a/sessions").ok());
  EXPECT_FALSE(ParseSession("sites/a/soundSources/b").ok());
}

TEST(ResourceNames, SessionsAreOfOneSite) {
  EXPECT_EQ(ParseSessionsOf("hall", {"sites/hall/sessions/b", "sites/hall/sessions/a"}).value(),
            (std::vector<std::string>{"b", "a"}));
  EXPECT_EQ(ParseSessionsOf("hall", {}).value(), std::vector<std::string>());
  EXPECT_FALSE(ParseSessionsOf("hall", {"sites/hall/sessions/b", "sites/yard/sessions/a"}).ok());
  EXPECT_FALSE(ParseSessionsOf("hall", {"b"}).ok());
}

}  // namespace
}  // namespace soundmap::api
