#pragma once

#include <cstring>

namespace soundmap::acoustics {

// Four numbers that are worked on at once.
typedef float Float4 __attribute__((vector_size(16)));

inline Float4 LoadFloat4(const float* p) {  // of any alignment
  Float4 value;
  std::memcpy(&value, p, sizeof(value));
  return value;
}

// Rows to columns.
inline void Transpose(Float4& a, Float4& b, Float4& c, Float4& d) {
  const Float4 ab_low = __builtin_shufflevector(a, b, 0, 4, 1, 5);
  const Float4 ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const Float4 cd_low = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const Float4 cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  a = __builtin_shufflevector(ab_low, cd_low, 0, 1, 4, 5);
  b = __builtin_shufflevector(ab_low, cd_low, 2, 3, 6, 7);
  c = __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5);
  d = __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7);
}

}  // namespace soundmap::acoustics
