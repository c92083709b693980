#pragma once

#include <algorithm>
#include <string>
#include <string_view>

namespace soundmap::fuzz {

// Several texts in one input: each with its size in two bytes before it, lowest first, but for the
// last one, which takes the rest.
inline std::string_view TakeField(std::string_view& bytes) {
  if (bytes.size() < 2) return {};
  const std::size_t size = static_cast<unsigned char>(bytes[0]) +
                           std::size_t{256} * static_cast<unsigned char>(bytes[1]);
  bytes.remove_prefix(2);
  const std::string_view field = bytes.substr(0, std::min(size, bytes.size()));
  bytes.remove_prefix(field.size());
  return field;
}

inline std::string MakeField(std::string_view field) {
  std::string bytes = {static_cast<char>(field.size()), static_cast<char>(field.size() >> 8)};
  return bytes.append(field);
}

}  // namespace soundmap::fuzz
