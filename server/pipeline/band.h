#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "pipeline/profile.h"

namespace soundmap::pipeline {

// A range of frequencies of which a site has a sound map of its own, beside that of its profile's
// band. The site's maps are numbered: 0 is the profile's, the bands follow in their order.
struct Band {
  std::string name;
  double f_min_hz = 0.0;  // both inclusive
  double f_max_hz = 0.0;

  bool operator==(const Band&) const = default;
};

inline constexpr std::uint8_t kMainBand = 0;
inline constexpr std::size_t kMaxBands = 8;

// InvalidArgument with a sentence that names the band: too many of them, one whose name is no name
// or another one's, edges that the profile cannot have.
absl::Status ValidateBands(const std::vector<Band>& bands, const Profile& profile);

// The site's profile, but for the frequencies.
Profile ProfileOf(const Band& band, const Profile& profile);

}  // namespace soundmap::pipeline
