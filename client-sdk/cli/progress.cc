#include "cli/progress.h"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace soundmap::cli {
namespace {

std::atomic<bool> interrupted{false};
static_assert(std::atomic<bool>::is_always_lock_free);

void OnInterrupt(int) { interrupted = true; }

}  // namespace

Progress::Progress() : is_terminal_(isatty(STDERR_FILENO) == 1) {
  struct sigaction action {};
  action.sa_handler = OnInterrupt;
  action.sa_flags = static_cast<int>(SA_RESETHAND | SA_RESTART);
  sigaction(SIGINT, &action, nullptr);
}

Progress::~Progress() {
  signal(SIGINT, SIG_DFL);
  Show("");
}

ProgressCallback Progress::ForOperation() {
  return [this](const Operation& operation) {
    Show(absl::StrFormat("%3.0f %%  %s%s", 100.0 * std::clamp(operation.progress, 0.0, 1.0),
                         operation.progress_text, interrupted ? " (cancelling)" : ""));
    return !interrupted;
  };
}

BytesCallback Progress::ForBytes() {
  return [this](std::int64_t bytes) {
    Show(absl::StrFormat("%.1f MB", static_cast<double>(bytes) * 1e-6));
    return !interrupted;
  };
}

void Progress::Show(const std::string& line) {
  if (!is_terminal_ || line == shown_) return;
  std::fprintf(stderr, "\r\033[K%s", line.c_str());
  std::fflush(stderr);
  shown_ = line;
}

}  // namespace soundmap::cli
