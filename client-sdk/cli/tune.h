#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "cli/evaluate.h"

// Which parameters find the sources best, on drives whose truth is known.
namespace soundmap::cli {

// One parameter of a profile and the values to try, as they stand in TOML.
struct Variation {
  std::string profile;
  std::string parameter;  // e.g. "acoustics.threshold_spreads"
  std::vector<std::string> values;
};

// "PROFILE.STAGE.PARAMETER=VALUE,VALUE,...". InvalidArgument: another form. Values that are no
// numbers or booleans are strings.
absl::StatusOr<Variation> ParseVariation(const std::string& text);

struct ParameterSet {
  std::string profile;
  std::vector<std::pair<std::string, std::string>> values;  // parameter, value
};

// Each profile with all combinations of its values. InvalidArgument: a variation of a profile that
// is not asked for, more than 1000 sets.
absl::StatusOr<std::vector<ParameterSet>> ParameterGrid(const std::vector<std::string>& profiles,
                                                        const std::vector<Variation>& variations);

std::string ToToml(const ParameterSet& set);
std::string Describe(const ParameterSet& set);  // "default, acoustics.threshold_spreads = 4"

// How a set of parameters did on all drives together.
struct SetScore {
  ParameterSet set;
  std::vector<SourceScore> of_site;
  SourceScore sources;  // of all sites
  Calibration calibration;
};

// The counts are sums, mean and deviation those of all detections.
SourceScore Sum(const std::vector<SourceScore>& scores);

// {"sites": [...], "sets": [{"profile", "parameters", "sources", "calibration", "of_site"}]}
std::string ToJson(const std::vector<std::string>& sites, const std::vector<SetScore>& scores);

// Detections, errors and reliability as one picture, drawn by gnuplot: SVG or PNG by the file's
// extension. FailedPrecondition: there is no gnuplot.
absl::Status PlotScores(const std::vector<SetScore>& scores, const std::string& path);

}  // namespace soundmap::cli
