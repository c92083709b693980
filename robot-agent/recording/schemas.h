#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace soundmap::recording {

// The serialized google.protobuf.FileDescriptorSet that declares a Foxglove message, dependencies
// first; none if `schema`
// ("foxglove.RawAudio") is not one of the recording format.
std::optional<std::string> DescriptorSetOf(std::string_view schema);

}  // namespace soundmap::recording
