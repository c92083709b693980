#pragma once

#include <cstdio>
#include <cstdlib>

namespace soundmap::benchmarks {

// What must hold before anything is timed.
inline void Require(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "the methods disagree: %s\n", what);
  std::exit(1);
}

}  // namespace soundmap::benchmarks
