// Calls the target with what libFuzzer makes of the seeds, which go to the folder FUZZ_SEEDS.
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>

#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const char* const folder = std::getenv("FUZZ_SEEDS");
  if (folder == nullptr) return 0;
  std::filesystem::create_directories(folder);
  int number = 0;
  for (const std::string& seed : soundmap::fuzz::Seeds()) {
    const auto path = std::filesystem::path(folder) / ("seed" + std::to_string(number++));
    std::ofstream(path, std::ios::binary) << seed;
  }
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  soundmap::fuzz::Decode({reinterpret_cast<const char*>(data), size});
  return 0;
}
