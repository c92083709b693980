#pragma once

#include <cstdint>
#include <string>

#include "soundmap/map_files.h"

namespace soundmap::cli {

// One line on standard error that changes in place while an operation runs; nothing if that is no
// terminal. Ctrl-C meanwhile asks to cancel; a second one ends the program.
class Progress {
 public:
  Progress();
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // For Client's methods; they return whether to go on. The Progress must outlive the call.
  ProgressCallback ForOperation();
  BytesCallback ForBytes();

 private:
  void Show(const std::string& line);

  const bool is_terminal_;
  std::string shown_;
};

}  // namespace soundmap::cli
