#include "cli/tune.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <regex>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace soundmap::cli {
namespace {

constexpr std::size_t kMaxSets = 1000;

// A number or a boolean stands as it is, other text becomes a string.
absl::StatusOr<std::string> TomlValue(absl::string_view text) {
  double number;
  if (text == "true" || text == "false" || absl::SimpleAtod(text, &number)) {
    return std::string(text);
  }
  if (text.empty() || text.find_first_of("'\"\n\\") != absl::string_view::npos) {
    return absl::InvalidArgumentError(absl::StrCat("'", text, "' is not a value to try"));
  }
  return absl::StrCat("'", text, "'");
}

nlohmann::ordered_json ToJson(const Calibration& calibration) {
  using nlohmann::ordered_json;
  const auto number = [](const std::optional<double>& value) {
    return value ? ordered_json(*value) : ordered_json(nullptr);
  };
  ordered_json bins = ordered_json::array();
  for (const Calibration::Bin& bin : calibration.bins) {
    bins.push_back({{"mean_probability", bin.mean_probability},
                    {"share_of_sources", bin.share_of_sources},
                    {"count", bin.count}});
  }
  return {{"candidates", calibration.candidates},
          {"expected_error", number(calibration.expected_error)},
          {"brier", number(calibration.brier)},
          {"bins", std::move(bins)}};
}

}  // namespace

absl::StatusOr<Variation> ParseVariation(const std::string& text) {
  static const std::regex form("([a-z]+)\\.([a-z0-9_]+(?:\\.[a-z0-9_]+)+)=([^\n]*)");
  std::smatch parts;
  if (!std::regex_match(text, parts, form)) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", text, "' is not of the form PROFILE.STAGE.PARAMETER=VALUE,VALUE,..."));
  }
  Variation variation{parts[1], parts[2], {}};
  const std::string values = parts[3];
  for (const absl::string_view part : absl::StrSplit(values, ',')) {
    auto value = TomlValue(part);
    if (!value.ok()) return value.status();
    variation.values.push_back(*std::move(value));
  }
  return variation;
}

absl::StatusOr<std::vector<ParameterSet>> ParameterGrid(const std::vector<std::string>& profiles,
                                                        const std::vector<Variation>& variations) {
  std::vector<ParameterSet> grid;
  std::size_t used = 0;
  for (const std::string& profile : profiles) {
    std::vector<ParameterSet> sets{{profile, {}}};
    for (const Variation& variation : variations) {
      if (variation.profile != profile) continue;
      ++used;
      if (sets.size() * variation.values.size() > kMaxSets) {
        return absl::InvalidArgumentError(
            absl::StrCat("the values make more than ", kMaxSets, " sets of parameters"));
      }
      std::vector<ParameterSet> combined;
      for (const ParameterSet& set : sets) {
        for (const std::string& value : variation.values) {
          combined.push_back(set);
          combined.back().values.emplace_back(variation.parameter, value);
        }
      }
      sets = std::move(combined);
    }
    grid.insert(grid.end(), sets.begin(), sets.end());
  }
  if (used != variations.size()) {
    return absl::InvalidArgumentError("a value is to be tried in a profile that is not asked for");
  }
  if (grid.size() > kMaxSets) {
    return absl::InvalidArgumentError(
        absl::StrCat("the values make more than ", kMaxSets, " sets of parameters"));
  }
  return grid;
}

std::string ToToml(const ParameterSet& set) {
  std::string text = absl::StrCat("profile = '", set.profile, "'\n");
  for (const auto& [parameter, value] : set.values) {
    absl::StrAppend(&text, parameter, " = ", value, "\n");
  }
  return text;
}

std::string Describe(const ParameterSet& set) {
  std::string text = set.profile;
  for (const auto& [parameter, value] : set.values) {
    absl::StrAppend(&text, ", ", parameter, " = ", value);
  }
  return text;
}

SourceScore Sum(const std::vector<SourceScore>& scores) {
  SourceScore sum;
  double error_sum_m = 0.0;
  double square_sum_m2 = 0.0;
  for (const SourceScore& score : scores) {
    sum.true_count += score.true_count;
    sum.detected += score.detected;
    sum.out_of_view += score.out_of_view;
    sum.false_count += score.false_count;
    sum.double_count += score.double_count;
    if (!score.error_mean_m) continue;
    error_sum_m += score.detected * *score.error_mean_m;
    square_sum_m2 += score.detected * (*score.error_mean_m * *score.error_mean_m +
                                       *score.error_std_m * *score.error_std_m);
  }
  if (sum.detected == 0) return sum;
  sum.error_mean_m = error_sum_m / sum.detected;
  sum.error_std_m = std::sqrt(
      std::max(0.0, square_sum_m2 / sum.detected - *sum.error_mean_m * *sum.error_mean_m));
  return sum;
}

std::string ToJson(const std::vector<std::string>& sites, const std::vector<SetScore>& scores) {
  using nlohmann::ordered_json;
  ordered_json sets = ordered_json::array();
  for (const SetScore& score : scores) {
    ordered_json parameters = ordered_json::object();
    for (const auto& [parameter, value] : score.set.values) parameters[parameter] = value;
    ordered_json of_site = ordered_json::array();
    for (const SourceScore& one : score.of_site) of_site.push_back(ToJson(one));
    sets.push_back({{"profile", score.set.profile},
                    {"parameters", std::move(parameters)},
                    {"sources", ToJson(score.sources)},
                    {"calibration", ToJson(score.calibration)},
                    {"of_site", std::move(of_site)}});
  }
  return ordered_json{{"sites", sites}, {"sets", std::move(sets)}}.dump();
}

}  // namespace soundmap::cli
