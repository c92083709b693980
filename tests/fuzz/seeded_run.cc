// fuzz_NAME CORPUS [COPIES]: decodes the seeds, all that stands in the folder, and damaged copies
// of both.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "tests/fuzz/target.h"

namespace {

std::string Damaged(std::string bytes, std::mt19937& random) {
  if (bytes.empty()) return bytes;
  const auto place = [&] { return random() % bytes.size(); };
  for (unsigned change = 0; change <= random() % 3; ++change) {
    switch (random() % 5) {
      case 0:
        bytes[place()] ^= static_cast<char>(1u << (random() % 8));
        break;
      case 1:
        bytes[place()] = static_cast<char>(random() % 2 == 0 ? 0xff : random());
        break;
      case 2:
        bytes.resize(place() + 1);
        break;
      case 3:
        bytes.insert(place(), bytes.substr(place(), random() % 16));
        break;
      default:
        // A number that no memory holds.
        for (std::size_t i = place(), end = std::min(bytes.size(), i + 4); i < end; ++i) {
          bytes[i] = '\x7f';
        }
    }
  }
  return bytes;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace soundmap::fuzz;
  std::vector<std::string> inputs = Seeds();
  std::error_code missing;
  for (const auto& file : std::filesystem::directory_iterator(argc > 1 ? argv[1] : "", missing)) {
    std::ostringstream bytes;
    bytes << std::ifstream(file.path(), std::ios::binary).rdbuf();
    inputs.push_back(bytes.str());
  }
  const int copies = argc > 2 ? std::atoi(argv[2]) : 2000;
  std::mt19937 random(1);
  for (const std::string& input : inputs) {
    Decode(input);
    for (int i = 0; i < copies; ++i) Decode(Damaged(input, random));
  }
  std::printf("%zu inputs and %d damaged copies of each\n", inputs.size(), copies);
  return inputs.empty() ? 1 : 0;
}
