#pragma once

#include "storage/check.h"

namespace soundmap::pipeline {

// Knows what the pipeline keeps in the store: records, geometric maps, poses, audio scans, tiles.
storage::ContentCheck MakeContentCheck();

}  // namespace soundmap::pipeline
