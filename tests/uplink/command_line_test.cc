#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <string>

namespace soundmap {
namespace {

using testing::HasSubstr;
using testing::MatchesRegex;

struct Outcome {
  int exit_status = -1;
  std::string errors;  // what stood on standard error
};

Outcome RunRobot(const std::string& arguments) {
  const std::string command = SOUNDMAP_BIN_DIR "/soundmap-robot " + arguments + " 2>&1 >/dev/null";
  std::FILE* pipe = popen(command.c_str(), "r");
  Outcome outcome;
  char buffer[256];
  while (std::fgets(buffer, sizeof(buffer), pipe) != nullptr) outcome.errors += buffer;
  const int status = pclose(pipe);
  if (WIFEXITED(status)) outcome.exit_status = WEXITSTATUS(status);
  return outcome;
}

TEST(CommandLine, WrongUsageIsTwoAndOneSentence) {
  for (const char* arguments :
       {"", "dance", "replay", "replay x.mcap --site s",
        "replay x.mcap --site s --robot r --speed 0",
        "replay x.mcap --site s --robot r --speed fast",
        "replay x.mcap --site s --robot r --initial-pose 1,2",
        "replay x.mcap --site s --robot r --initial-pose 1,2,nan",
        "replay x.mcap --site s --robot r --purpose dancing", "simulate office"}) {
    const Outcome outcome = RunRobot(arguments);
    EXPECT_EQ(outcome.exit_status, 2) << arguments;
    EXPECT_THAT(outcome.errors, MatchesRegex("soundmap-robot: [^\n]+\n")) << arguments;
  }
}

TEST(CommandLine, HelpIsNoError) {
  EXPECT_EQ(RunRobot("--help").exit_status, 0);
  EXPECT_EQ(RunRobot("replay --help").exit_status, 0);
  EXPECT_EQ(RunRobot("replay --help").errors, "");
}

TEST(CommandLine, AFailureIsOneAndNamesWhatIsAtFault) {
  const Outcome outcome =
      RunRobot("replay /nowhere/x.mcap --site s --robot r --initial-pose -1,2.5,-0.5");
  EXPECT_EQ(outcome.exit_status, 1);
  EXPECT_THAT(outcome.errors, MatchesRegex("soundmap-robot: [^\n]+\n"));
  EXPECT_THAT(outcome.errors, HasSubstr("/nowhere/x.mcap"));
}

}  // namespace
}  // namespace soundmap
