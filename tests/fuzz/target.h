#pragma once

#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

// What each program here defines.
namespace soundmap::fuzz {

// Whole, good inputs that make the decoder go far.
std::vector<std::string> Seeds();

// Decodes. Ends the process where something is not as it must be.
void Decode(std::string_view bytes);

inline void Require(bool holds) {
  if (!holds) std::abort();
}

}  // namespace soundmap::fuzz
