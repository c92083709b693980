#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

// The layers of the repository, held against its sources: which folder may include which.
namespace soundmap {
namespace {

using Names = std::set<std::string>;

const std::filesystem::path kRoot = SOUNDMAP_SOURCE_DIR;

// Folders of the server, besides themselves. `recording` is robot-agent/recording.
const std::map<std::string, Names>& AllowedOfServer() {
  static const std::map<std::string, Names> allowed = [] {
    std::map<std::string, Names> table{
        {"geometry", {}},
        {"frames", {"geometry"}},
        {"building", {"geometry", "frames"}},
        {"mapping", {"geometry", "frames", "building"}},
        {"localization", {"geometry", "frames", "building"}},
        {"acoustics", {"geometry", "frames"}},
        {"sound_map", {"geometry", "frames"}},
        {"ray_casting",
         {"geometry", "frames", "building", "localization/pose_estimate.h",
          "acoustics/likelihood_scan.h", "sound_map/evidence.h"}},
        {"storage", {"geometry", "frames", "building", "sound_map", "recording"}},
        {"pipeline",
         {"geometry", "frames", "building", "mapping", "localization", "acoustics", "sound_map",
          "ray_casting", "storage"}},
        {"web_gateway", {"api"}},
    };
    table["api"] = table["pipeline"];
    table["api"].insert({"pipeline", "recording"});
    return table;
  }();
  return allowed;
}

// By folder of the other processes; only folders of this repository are looked at.
const std::map<std::string, Names> kAllowedOfClients{
    {"robot-agent/recording", {}},
    {"robot-agent/sources", {"recording"}},
    {"robot-agent/spool", {"recording", "sources"}},
    {"robot-agent/uplink", {"recording", "sources", "spool"}},
    {"robot-agent", {"recording", "sources", "spool", "uplink"}},
    {"client-sdk/cli", {"recording"}},
    {"client-sdk", {}},
};

const Names kMayIncludeProtobuf{
    "server/api",          "server/web_gateway", "robot-agent/recording",
    "robot-agent/sources", "robot-agent/spool",  "robot-agent/uplink",
    "client-sdk"};

const Names kAgentFolders{"recording", "sources", "spool", "uplink"};

bool LiesIn(const std::string& path, const std::string& folder) {
  return path.rfind(folder + "/", 0) == 0;
}

std::string FirstPart(const std::string& path) { return path.substr(0, path.find('/')); }

// What is wrong with a line `#include "included"` in the source `path`, both with forward slashes
// and `path` from the root of the repository; empty if nothing is.
std::string Fault(const std::string& path, const std::string& included) {
  if (included.find(".pb.h") != std::string::npos) {
    for (const std::string& folder : kMayIncludeProtobuf) {
      if (LiesIn(path, folder)) return "";
    }
    return "generated protobuf code stops at the API, the recordings and the clients";
  }
  if (included.find("..") != std::string::npos) return "includes go from the top, without ..";
  if (included.find('/') == std::string::npos) return "";
  const std::string target = FirstPart(included);
  const bool of_server = AllowedOfServer().count(target) != 0;
  if (!of_server && kAgentFolders.count(target) == 0) return "";

  if (LiesIn(path, "server")) {
    const std::string inside = path.substr(std::string("server/").size());
    const std::string folder = FirstPart(inside);
    if (inside == folder)
      return target == "recording" || of_server ? "" : "not a part of the server";
    const auto allowed = AllowedOfServer().find(folder);
    if (allowed == AllowedOfServer().end()) return "the folder is in no layer";
    if (target == folder || allowed->second.count(target) != 0 ||
        allowed->second.count(included) != 0) {
      return "";
    }
    return folder + " may not include " + (of_server ? target : "robot-agent/" + target);
  }
  if (of_server) return "processes share no code with the server";
  // The longest folder decides.
  const Names* allowed = nullptr;
  std::string of;
  for (const auto& [folder, names] : kAllowedOfClients) {
    if (LiesIn(path, folder) && folder.size() > of.size()) {
      of = folder;
      allowed = &names;
    }
  }
  if (allowed == nullptr) return "the folder is in no layer";
  if (of == "robot-agent/" + target || allowed->count(target) != 0) return "";
  return of + " may not include robot-agent/" + target;
}

struct Line {
  std::string path;
  int number;
  std::string included;
};

std::string Read(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

std::vector<std::filesystem::path> Sources(const std::string& folder) {
  std::vector<std::filesystem::path> sources;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(kRoot / folder)) {
    const std::string extension = entry.path().extension().string();
    if (entry.is_regular_file() && (extension == ".h" || extension == ".cc")) {
      sources.push_back(entry.path());
    }
  }
  return sources;
}

std::vector<Line> Includes(const std::string& folder) {
  static const std::regex include(R"(^\s*#\s*include\s*[<"]([^>"]+)[>"])");
  std::vector<Line> lines;
  for (const std::filesystem::path& source : Sources(folder)) {
    std::istringstream text(Read(source));
    std::string line;
    for (int number = 1; std::getline(text, line); ++number) {
      std::smatch match;
      if (std::regex_search(line, match, include)) {
        lines.push_back(
            {std::filesystem::relative(source, kRoot).generic_string(), number, match[1]});
      }
    }
  }
  return lines;
}

class IncludesOf : public testing::TestWithParam<const char*> {};

TEST_P(IncludesOf, FollowTheLayers) {
  const std::vector<Line> lines = Includes(GetParam());
  EXPECT_FALSE(lines.empty());
  for (const Line& line : lines) {
    const std::string fault = Fault(line.path, line.included);
    EXPECT_TRUE(fault.empty()) << line.path << ":" << line.number << " includes \"" << line.included
                               << "\": " << fault;
  }
}

INSTANTIATE_TEST_SUITE_P(Processes, IncludesOf,
                         testing::Values("server", "robot-agent", "client-sdk"),
                         [](const auto& info) {
                           std::string name = info.param;
                           std::erase(name, '-');
                           return name;
                         });

TEST(Architecture, EveryFolderOfTheServerIsInALayer) {
  for (const auto& entry : std::filesystem::directory_iterator(kRoot / "server")) {
    if (!entry.is_directory()) continue;
    EXPECT_EQ(AllowedOfServer().count(entry.path().filename().string()), 1u) << entry.path();
  }
}

TEST(Architecture, TheRuleSeesEachKindOfFault) {
  const auto fault = [](const char* path, const char* included) {
    return !Fault(path, included).empty();
  };
  EXPECT_TRUE(fault("server/geometry/pose.h", "frames/frames.h"));
  EXPECT_TRUE(fault("server/localization/localizer.h", "acoustics/likelihood_scan.h"));
  EXPECT_TRUE(fault("server/ray_casting/caster.cc", "localization/localizer.h"));
  EXPECT_TRUE(fault("server/sound_map/map.cc", "storage/store.h"));
  EXPECT_TRUE(fault("server/pipeline/session.cc", "api/convert.h"));
  EXPECT_TRUE(fault("server/pipeline/session.cc", "soundmap/v1/types.pb.h"));
  EXPECT_TRUE(fault("server/pipeline/session.cc", "foxglove/LaserScan.pb.h"));
  EXPECT_TRUE(fault("server/mapping/mapper.cc", "recording/reader.h"));
  EXPECT_TRUE(fault("server/api/convert.cc", "uplink/uploader.h"));
  EXPECT_TRUE(fault("server/novelty/new.cc", "geometry/pose.h"));
  EXPECT_TRUE(fault("server/frames/frames.h", "../geometry/pose.h"));
  EXPECT_TRUE(fault("robot-agent/sources/replay.cc", "geometry/pose.h"));
  EXPECT_TRUE(fault("robot-agent/recording/reader.cc", "sources/replay.h"));
  EXPECT_TRUE(fault("client-sdk/src/client.cc", "recording/reader.h"));
  EXPECT_TRUE(fault("client-sdk/cli/main.cc", "sound_map/evidence.h"));

  EXPECT_FALSE(fault("server/localization/localizer.h", "localization/config.h"));
  EXPECT_FALSE(fault("server/ray_casting/caster.cc", "localization/pose_estimate.h"));
  EXPECT_FALSE(fault("server/api/convert.h", "soundmap/v1/types.pb.h"));
  EXPECT_FALSE(fault("server/api/ingest.cc", "recording/reader.h"));
  EXPECT_FALSE(fault("server/main.cc", "web_gateway/gateway.h"));
  EXPECT_FALSE(fault("client-sdk/cli/main.cc", "recording/reader.h"));
  EXPECT_FALSE(fault("robot-agent/uplink/uploader.cc", "absl/status/status.h"));
}

// Every rpc of every service that is declared is overridden in server/api.
TEST(Architecture, WhatIsDeclaredIsServed) {
  std::map<std::string, std::string> headers;  // by name of the file
  for (const std::filesystem::path& source : Sources("server/api")) {
    if (source.extension() == ".h") headers[source.filename().string()] = Read(source);
  }
  ASSERT_FALSE(headers.empty());
  static const std::regex service(R"(service\s+(\w+)\s*\{([^}]*)\})");
  static const std::regex rpc(R"(\brpc\s+(\w+)\s*\()");
  static const std::regex comment(R"(//[^\n]*)");
  int services = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kRoot / "proto/soundmap/v1")) {
    if (entry.path().extension() != ".proto") continue;
    const std::string text = std::regex_replace(Read(entry.path()), comment, "");
    for (std::sregex_iterator s(text.begin(), text.end(), service), end; s != end; ++s) {
      ++services;
      const std::string name = (*s)[1];
      const std::string* header = nullptr;
      for (const auto& [file, content] : headers) {
        if (content.find("::" + name + "::CallbackService") != std::string::npos) header = &content;
      }
      if (header == nullptr) {
        ADD_FAILURE() << entry.path() << ": no class in server/api serves " << name;
        continue;
      }
      const std::string body = (*s)[2];
      for (std::sregex_iterator r(body.begin(), body.end(), rpc); r != end; ++r) {
        const std::string method = (*r)[1];
        EXPECT_TRUE(
            std::regex_search(*header, std::regex("\\b" + method + R"(\s*\([^;{]*\)\s*override)")))
            << entry.path() << ": " << name << "." << method << " is declared and not served";
      }
    }
  }
  EXPECT_GT(services, 0);
}

}  // namespace
}  // namespace soundmap
