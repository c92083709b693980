#pragma once

#include <string>

#include "api/access.h"
#include "pipeline/meters.h"

namespace soundmap {

// What Prometheus reads: the meters, refused calls, and what the process takes.
std::string MetricsText(const pipeline::Meters& meters, const api::Access& access);

}  // namespace soundmap
