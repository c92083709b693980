#pragma once

// toml++ as the whole server reads TOML. Errors are values. Its assertions do not hold for every
// text, "[=]" for one, and an error stands behind each of them.
#define TOML_EXCEPTIONS 0
#define TOML_ASSERT(condition) static_cast<void>(0)
#include <toml++/toml.h>
