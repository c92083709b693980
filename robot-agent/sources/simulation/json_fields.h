#pragma once

#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"

namespace soundmap::simulation {

// The first thing wrong with a file, as one sentence that names file and field.
class JsonErrors {
 public:
  explicit JsonErrors(std::string file) : file_(std::move(file)) {}
  void Add(std::string_view field, std::string_view sentence);
  bool ok() const { return status_.ok(); }
  const absl::Status& status() const { return status_; }

 private:
  std::string file_;
  absl::Status status_;
};

struct Limits {
  double min = std::numeric_limits<double>::lowest();
  double max = std::numeric_limits<double>::max();
};

// Reads the members of one JSON object by name. After an error each getter returns its default
// (numbers: 0 if there is none), and the error stands in `errors`. A member that no getter asked
// for is an error of Finish().
class JsonFields {
 public:
  JsonFields(const nlohmann::json& object, std::string path, JsonErrors& errors);

  bool Has(const std::string& name);
  double Number(const std::string& name, Limits limits, std::optional<double> fallback = {});
  int Integer(const std::string& name, int min, int max, std::optional<int> fallback = {});
  bool Bool(const std::string& name, bool fallback);
  std::string String(const std::string& name, std::optional<std::string> fallback = {});
  // Exactly `count` numbers.
  std::vector<double> Numbers(const std::string& name, int count, Limits limits,
                              std::optional<std::vector<double>> fallback = {});
  // The elements of an array, which may be absent; at most `max_count`.
  std::vector<nlohmann::json> Elements(const std::string& name, int max_count);
  // A member object; an empty one if it is absent.
  JsonFields Object(const std::string& name);

  const nlohmann::json* Raw(const std::string& name);
  std::string PathOf(const std::string& name) const;
  JsonErrors& errors() { return errors_; }
  void Finish();

 private:
  nlohmann::json object_;
  std::string path_;
  JsonErrors& errors_;
  std::set<std::string> known_;
};

// One element as `count` numbers; zeros after an error.
std::vector<double> NumbersOf(const nlohmann::json& element, const std::string& path, int count,
                              Limits limits, JsonErrors& errors);

}  // namespace soundmap::simulation
