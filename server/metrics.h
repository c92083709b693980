#pragma once

#include <string>

#include "pipeline/stage_times.h"

namespace soundmap {

// What Prometheus reads: the meters, and what the process takes.
std::string MetricsText(const pipeline::Meters& meters);

}  // namespace soundmap
