// Prints the sound sources of a site: list_sources SITE [HOST:PORT]
#include <cstdio>

#include "soundmap/client.h"

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: list_sources SITE [HOST:PORT]\n");
    return 2;
  }
  soundmap::ClientOptions options;
  if (argc > 2) options.server = argv[2];
  auto client = soundmap::Client::Connect(options);
  if (!client.ok()) {
    std::fprintf(stderr, "%s\n", client.status().ToString().c_str());
    return 1;
  }
  const auto list = client->ListSoundSources({.site = argv[1], .min_probability = 0.5});
  if (!list.ok()) {
    std::fprintf(stderr, "%s\n", list.status().ToString().c_str());
    return 1;
  }
  for (const soundmap::SoundSource& source : list->sources) {
    const soundmap::Vector3& p = source.position_in_map_m;
    std::printf("%s at (%.2f, %.2f, %.2f) m, probability %.2f\n", source.id.c_str(), p.x, p.y, p.z,
                source.probability);
    if (source.mirror_in_map_m) {
      const soundmap::Vector3& m = *source.mirror_in_map_m;
      std::printf("  or at (%.2f, %.2f, %.2f) m: the array cannot tell\n", m.x, m.y, m.z);
    }
  }
}
