#include "spool/spool.h"

#include "tests/fuzz/fields.h"
#include "tests/fuzz/target.h"
#include "tests/fuzz/temporary_folder.h"
#include "tests/uplink/spooled_frames.h"

namespace soundmap::fuzz {
namespace {

constexpr char kSession[] = "drive";
constexpr int kFrames = 12;

const TemporaryFolder& Folder() {
  static const TemporaryFolder folder;
  return folder;
}

spool::SpoolOptions Options() {
  spool::SpoolOptions options = spool::SmallSegments();
  options.segment_bytes = 1000;
  options.max_bytes = 1 << 20;
  return options;
}

std::string Seed(bool ended, std::int64_t freed) {
  const std::string folder = Folder().Empty("seed");
  {
    const auto spool = spool::Reopen(folder, Options());
    Require(spool->Begin(spool::RequestFor(kSession)).ok());
    for (int i = 0; i < kFrames; ++i) Require(spool->Append(spool::FrameAt(i)).ok());
    if (ended) Require(spool->End().ok());
  }
  const std::string session = folder + "/" + kSession;
  auto segments = spool::ListSegments(session).value();
  Require(segments.size() >= 3);
  if (freed > 0) {
    // One is lost, and the record says so once the server was to get it.
    std::filesystem::remove(segments[1].path);
    const auto spool = spool::Reopen(folder, Options());
    const auto source = spool->Read(kSession);
    Require(source->Seek(0).ok());
    while (source->Next().value()) {
    }
    segments.erase(segments.begin() + 1);
  }
  return MakeField(ReadFile(session + "/session.json")) + MakeField(ReadFile(segments[0].path)) +
         static_cast<char>(segments[1].first) + ReadFile(segments[1].path);
}

}  // namespace

// session.json, the first segment, the position of another one and the same of that.
std::vector<std::string> Seeds() { return {Seed(false, 0), Seed(true, 0), Seed(true, 1)}; }

void Decode(std::string_view bytes) {
  const std::string folder = Folder().Empty("spool");
  const std::string session = folder + "/" + kSession;
  std::filesystem::create_directory(session);
  WriteFile(session + "/session.json", TakeField(bytes));
  WriteFile(spool::SegmentPath(session, 0), TakeField(bytes));
  if (!bytes.empty()) {
    WriteFile(spool::SegmentPath(session, static_cast<unsigned char>(bytes[0])), bytes.substr(1));
  }
  (void)spool::Inspect(folder);
  std::vector<std::string> first;
  for (int time = 0; time < 2; ++time) {
    const auto spool = spool::Reopen(folder, Options());
    Require(spool->warnings().size() <= 1);
    const auto source = spool->Read(kSession);
    if (!spool->warnings().empty()) {
      Require(spool->Waiting().empty() && !source->Seek(0).ok());
      return;
    }
    // What the server gets is the same however often it is read, also after a restart.
    std::vector<std::string> frames;
    if (!source->Seek(0).ok()) return;
    while (true) {
      const auto frame = source->Next();
      if (!frame.ok() || !frame->has_value()) break;
      frames.push_back((*frame)->payload);
      Require(frames.size() <= bytes.size() + 70'000);
    }
    if (time == 1) Require(frames == first);
    first = std::move(frames);
  }
}

}  // namespace soundmap::fuzz
