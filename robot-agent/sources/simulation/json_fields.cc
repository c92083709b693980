#include "sources/simulation/json_fields.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace soundmap::simulation {
namespace {

std::string Range(Limits limits) {
  const bool lower = limits.min > std::numeric_limits<double>::lowest();
  const bool upper = limits.max < std::numeric_limits<double>::max();
  if (lower && upper) return absl::StrFormat("a number from %g to %g", limits.min, limits.max);
  if (lower) return absl::StrFormat("a number of at least %g", limits.min);
  if (upper) return absl::StrFormat("a number of at most %g", limits.max);
  return "a number";
}

bool Within(const nlohmann::json& value, Limits limits) {
  if (!value.is_number()) return false;
  const double number = value.get<double>();
  return std::isfinite(number) && number >= limits.min && number <= limits.max;
}

}  // namespace

void JsonErrors::Add(std::string_view field, std::string_view sentence) {
  if (!status_.ok()) return;
  status_ = absl::InvalidArgumentError(
      absl::StrCat(file_, ": field '", std::string(field), "' ", std::string(sentence)));
}

JsonFields::JsonFields(const nlohmann::json& object, std::string path, JsonErrors& errors)
    : object_(object), path_(std::move(path)), errors_(errors) {
  if (!object_.is_object()) {
    errors_.Add(path_.empty() ? "(top)" : path_, "must be an object");
    object_ = nlohmann::json::object();
  }
}

std::string JsonFields::PathOf(const std::string& name) const {
  return path_.empty() ? name : absl::StrCat(path_, ".", name);
}

const nlohmann::json* JsonFields::Raw(const std::string& name) {
  known_.insert(name);
  const auto found = object_.find(name);
  return found == object_.end() ? nullptr : &*found;
}

bool JsonFields::Has(const std::string& name) { return Raw(name) != nullptr; }

double JsonFields::Number(const std::string& name, Limits limits, std::optional<double> fallback) {
  const auto* value = Raw(name);
  if (value == nullptr && fallback) return *fallback;
  if (value == nullptr) {
    errors_.Add(PathOf(name), absl::StrCat("is missing: it must be ", Range(limits)));
  } else if (!Within(*value, limits)) {
    errors_.Add(PathOf(name), absl::StrCat("must be ", Range(limits)));
  } else {
    return value->get<double>();
  }
  return fallback.value_or(0.0);
}

int JsonFields::Integer(const std::string& name, int min, int max, std::optional<int> fallback) {
  const Limits limits{static_cast<double>(min), static_cast<double>(max)};
  const double value =
      Number(name, limits, fallback ? std::optional<double>(*fallback) : std::nullopt);
  if (value != std::floor(value)) {
    errors_.Add(PathOf(name), "must be a whole number");
    return fallback.value_or(min);
  }
  return static_cast<int>(value);
}

bool JsonFields::Bool(const std::string& name, bool fallback) {
  const auto* value = Raw(name);
  if (value == nullptr) return fallback;
  if (!value->is_boolean()) {
    errors_.Add(PathOf(name), "must be true or false");
    return fallback;
  }
  return value->get<bool>();
}

std::string JsonFields::String(const std::string& name, std::optional<std::string> fallback) {
  const auto* value = Raw(name);
  if (value == nullptr && fallback) return *fallback;
  if (value == nullptr || !value->is_string()) {
    errors_.Add(PathOf(name),
                value == nullptr ? "is missing: it must be a text" : "must be a text");
    return fallback.value_or("");
  }
  return value->get<std::string>();
}

std::vector<double> JsonFields::Numbers(const std::string& name, int count, Limits limits,
                                        std::optional<std::vector<double>> fallback) {
  const auto* value = Raw(name);
  if (value == nullptr) {
    if (fallback) return *fallback;
    errors_.Add(PathOf(name), absl::StrCat("is missing: it must be ", count, " numbers"));
    return std::vector<double>(count, 0.0);
  }
  return NumbersOf(*value, PathOf(name), count, limits, errors_);
}

std::vector<nlohmann::json> JsonFields::Elements(const std::string& name, int max_count) {
  const auto* value = Raw(name);
  if (value == nullptr) return {};
  if (!value->is_array() || value->size() > static_cast<std::size_t>(max_count)) {
    errors_.Add(PathOf(name), absl::StrCat("must be a list of at most ", max_count, " elements"));
    return {};
  }
  return {value->begin(), value->end()};
}

JsonFields JsonFields::Object(const std::string& name) {
  const auto* value = Raw(name);
  return JsonFields(value == nullptr ? nlohmann::json::object() : *value, PathOf(name), errors_);
}

void JsonFields::Finish() {
  for (const auto& [name, value] : object_.items()) {
    if (!known_.contains(name)) errors_.Add(PathOf(name), "is not one that a scene has");
  }
}

std::vector<double> NumbersOf(const nlohmann::json& element, const std::string& path, int count,
                              Limits limits, JsonErrors& errors) {
  std::vector<double> numbers(count, 0.0);
  bool good = element.is_array() && element.size() == static_cast<std::size_t>(count);
  for (int i = 0; good && i < count; ++i) {
    good = Within(element[i], limits);
    if (good) numbers[i] = element[i].get<double>();
  }
  if (!good) {
    errors.Add(path, absl::StrCat("must be ", count, " numbers, each ", Range(limits)));
    return std::vector<double>(count, 0.0);
  }
  return numbers;
}

}  // namespace soundmap::simulation
