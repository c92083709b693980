// Asks a running server the questions that an app asks, at a steady pace, and prints how long the
// answers took as one line of JSON.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <iostream>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "soundmap/client.h"

namespace soundmap::benchmarks {
namespace {

using Clock = std::chrono::steady_clock;

struct Question {
  std::string name;
  std::vector<double> latency_ms;
  std::int64_t answers = 0;  // voxels or sources
};

nlohmann::json Summary(Question& question) {
  std::vector<double>& ms = question.latency_ms;
  std::sort(ms.begin(), ms.end());
  const auto quantile = [&ms](double share) {
    return ms[static_cast<std::size_t>(share * static_cast<double>(ms.size() - 1))];
  };
  return {{"count", ms.size()},
          {"p50_ms", quantile(0.5)},
          {"p90_ms", quantile(0.9)},
          {"p99_ms", quantile(0.99)},
          {"max_ms", ms.back()},
          {"answers_mean", static_cast<double>(question.answers) / static_cast<double>(ms.size())}};
}

int Main(int argc, char** argv) {
  CLI::App app("Times box queries and source lists of a site while it is in use.", "query_latency");
  std::string server;
  std::string site;
  double seconds = 20.0;
  double rate_hz = 25.0;
  double edge_m = 2.0;
  std::vector<double> room_m;
  app.add_option("--server", server, "HOST:PORT")->envname("SOUNDMAP_SERVER")->required();
  app.add_option("--site", site, "the site")->required();
  app.add_option("--seconds", seconds, "how long")->check(CLI::PositiveNumber);
  app.add_option("--rate", rate_hz, "questions of each kind a second")->check(CLI::PositiveNumber);
  app.add_option("--edge", edge_m, "of the boxes, in metres")->check(CLI::PositiveNumber);
  app.add_option("--room", room_m, "the boxes lie in a room of this size, from the origin")
      ->expected(3)
      ->required();
  CLI11_PARSE(app, argc, argv);

  ClientOptions options;
  options.server = server;
  auto client = Client::Connect(options);
  if (!client.ok()) {
    std::cerr << "query_latency: " << client.status().message() << '\n';
    return 1;
  }
  Question box{"box_query", {}, 0};
  Question list{"source_list", {}, 0};
  std::mt19937_64 random(1);
  absl::Status failed;
  const auto ask = [&](Question& question, auto answer) {
    const auto begin = Clock::now();
    const absl::StatusOr<std::int64_t> answers = answer();
    question.latency_ms.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
    if (!answers.ok())
      failed = answers.status();
    else
      question.answers += *answers;
  };
  const auto begin = Clock::now();
  const int rounds = std::max(1, static_cast<int>(seconds * rate_hz));
  for (int i = 0; i < rounds && failed.ok(); ++i) {
    std::this_thread::sleep_until(
        begin + std::chrono::duration_cast<Clock::duration>(
                    std::chrono::duration<double>(static_cast<double>(i) / rate_hz)));
    VoxelQuery query{.site = site};
    Box& asked = query.box_in_map.emplace();
    const auto place = [&](double size_m) {
      return std::uniform_real_distribution<double>(0.0, std::max(0.0, size_m - edge_m))(random);
    };
    asked.min_m = {place(room_m[0]), place(room_m[1]), place(room_m[2])};
    asked.max_m = {asked.min_m.x + edge_m, asked.min_m.y + edge_m, asked.min_m.z + edge_m};
    ask(box, [&]() -> absl::StatusOr<std::int64_t> {
      std::int64_t voxels = 0;
      const absl::Status status = client->QueryVoxels(query, [&voxels](const VoxelColumns& chunk) {
        voxels += static_cast<std::int64_t>(chunk.size());
        return true;
      });
      if (!status.ok()) return status;
      return voxels;
    });
    ask(list, [&]() -> absl::StatusOr<std::int64_t> {
      const auto sources = client->ListSoundSources({.site = site});
      if (!sources.ok()) return sources.status();
      return static_cast<std::int64_t>(sources->sources.size());
    });
  }
  if (!failed.ok()) {
    std::cerr << "query_latency: " << failed.message() << '\n';
    return 1;
  }
  std::cout << nlohmann::json{{box.name, Summary(box)}, {list.name, Summary(list)}}.dump() << '\n';
  return 0;
}

}  // namespace
}  // namespace soundmap::benchmarks

int main(int argc, char** argv) { return soundmap::benchmarks::Main(argc, argv); }
