#include "pipeline/band.h"

#include <set>

#include "absl/strings/str_cat.h"
#include "storage/names.h"

namespace soundmap::pipeline {

absl::Status ValidateBands(const std::vector<Band>& bands, const Profile& profile) {
  if (bands.size() > kMaxBands) {
    return absl::InvalidArgumentError(
        absl::StrCat("a site has at most ", kMaxBands, " bands, not ", bands.size()));
  }
  std::set<std::string> names;
  for (const Band& band : bands) {
    const absl::Status named = storage::ValidateName("band", band.name);
    if (!named.ok()) return named;
    if (!names.insert(band.name).second) {
      return absl::InvalidArgumentError(absl::StrCat("the band '", band.name, "' is given twice"));
    }
    const absl::Status valid = ProfileOf(band, profile).Validate();
    if (!valid.ok()) {
      return absl::InvalidArgumentError(
          absl::StrCat("the band '", band.name, "' cannot be heard: ", valid.message()));
    }
  }
  return absl::OkStatus();
}

Profile ProfileOf(const Band& band, const Profile& profile) {
  Profile of_band = profile;
  of_band.acoustics.f_min_hz = band.f_min_hz;
  of_band.acoustics.f_max_hz = band.f_max_hz;
  return of_band;
}

}  // namespace soundmap::pipeline
