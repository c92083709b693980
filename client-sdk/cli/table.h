#pragma once

#include <ostream>
#include <string>
#include <vector>

namespace soundmap::cli {

// Columns for people: as wide as their longest cell, two spaces apart. Text stands left, numbers
// right.
class Table {
 public:
  enum class Align { kLeft, kRight };
  struct Column {
    std::string title;
    Align align = Align::kLeft;
  };

  explicit Table(std::vector<Column> columns);
  // As many cells as there are columns.
  void Add(std::vector<std::string> cells);
  void Print(std::ostream& out) const;

 private:
  std::vector<Column> columns_;
  std::vector<std::vector<std::string>> rows_;
};

// A number with that many decimals.
std::string Fixed(double value, int decimals);

}  // namespace soundmap::cli
