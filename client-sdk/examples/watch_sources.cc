// Tells which sound sources of a site appear, change and go: watch_sources SITE [HOST:PORT]
#include <cstdio>

#include "soundmap/client.h"

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: watch_sources SITE [HOST:PORT]\n");
    return 2;
  }
  soundmap::ClientOptions options;
  if (argc > 2) options.server = argv[2];
  auto client = soundmap::Client::Connect(options);
  if (!client.ok()) {
    std::fprintf(stderr, "%s\n", client.status().ToString().c_str());
    return 1;
  }
  const absl::Status status = client->Watch(
      {.site = argv[1], .sound_sources = true}, [](const soundmap::WatchEvent& event) {
        if (const auto* source = std::get_if<soundmap::SoundSource>(&event.event)) {
          const soundmap::Vector3& p = source->position_in_map_m;
          std::printf("%s: (%.2f, %.2f, %.2f) m, probability %.2f\n", source->id.c_str(), p.x, p.y,
                      p.z, source->probability);
        } else if (const auto* gone = std::get_if<soundmap::RemovedSoundSource>(&event.event)) {
          std::printf("%s: gone\n", gone->id.c_str());
        }
        std::fflush(stdout);
        return true;
      });
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
