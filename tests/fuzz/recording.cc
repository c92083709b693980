#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <fstream>
#include <sstream>

#include "recording/reader.h"
#include "recording/writer.h"
#include "tests/fuzz/target.h"

namespace soundmap::fuzz {
namespace {

// A file in memory.
class MemoryFile {
 public:
  MemoryFile() : file_(::memfd_create("recording", MFD_CLOEXEC)) { Require(file_ >= 0); }
  ~MemoryFile() { ::close(file_); }
  std::string path() const { return "/proc/self/fd/" + std::to_string(file_); }

  void Write(std::string_view bytes) {
    Require(::ftruncate(file_, 0) == 0 && ::lseek(file_, 0, SEEK_SET) == 0);
    Require(::write(file_, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size()));
  }
  std::string Read() const {
    std::ostringstream bytes;
    bytes << std::ifstream(path(), std::ios::binary).rdbuf();
    return bytes.str();
  }

 private:
  const int file_;
};

}  // namespace

std::vector<std::string> Seeds() {
  std::vector<std::string> seeds;
  for (const auto compression : {recording::Compression::kNone, recording::Compression::kLz4,
                                 recording::Compression::kZstd}) {
    for (const bool chunked : {true, false}) {
      const MemoryFile file;
      recording::WriterOptions options;
      options.compression = compression;
      options.chunked = chunked;
      options.chunk_bytes = 100;
      auto writer = recording::Writer::Create(file.path(), options);
      Require(writer.ok());
      for (int i = 0; i < 6; ++i) {
        Require((*writer)
                    ->Write(i % 2 == 0 ? "/odom" : "/scan",
                            i % 2 == 0 ? "foxglove.Odometry" : "foxglove.LaserScan", i, 0,
                            std::string(20, static_cast<char>('a' + i)))
                    .ok());
      }
      Require((*writer)->Close().ok());
      seeds.push_back(file.Read());
    }
  }
  return seeds;
}

void Decode(std::string_view bytes) {
  static MemoryFile file;
  file.Write(bytes);
  recording::ReaderLimits limits;
  limits.max_chunk_uncompressed_bytes = 16 << 20;
  auto reader = recording::Reader::Open(file.path(), limits);
  if (!reader.ok()) return;
  while (true) {
    const auto message = (*reader)->Next();
    Require((*reader)->position_bytes() <= (*reader)->size_bytes());
    if (message.ok() && message->has_value()) continue;
    // An error stays.
    if (!message.ok()) Require((*reader)->Next().status() == message.status());
    return;
  }
}

}  // namespace soundmap::fuzz
