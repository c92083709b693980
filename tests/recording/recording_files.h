#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "recording/message.h"
#include "recording/reader.h"

namespace soundmap::recording {

bool operator==(const Message& a, const Message& b);
std::ostream& operator<<(std::ostream& out, const Message& message);

// A path in the test's own temporary folder, with nothing there.
std::string FreshPath(const std::string& name);
std::string FileBytes(const std::string& path);
void WriteFileBytes(const std::string& path, std::string_view bytes);

// All that a reader delivers of a file, and how it ended.
struct Delivered {
  std::vector<Message> messages;
  absl::Status status;
};
Delivered ReadAll(const std::string& path, const ReaderLimits& limits = {});

// `count` messages of three topics with different times and sizes, none empty but one.
std::vector<Message> SomeMessages(int count);

}  // namespace soundmap::recording
