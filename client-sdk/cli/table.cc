#include "cli/table.h"

#include <algorithm>

#include "absl/strings/str_format.h"

namespace soundmap::cli {

Table::Table(std::vector<Column> columns) : columns_(std::move(columns)) {}

void Table::Add(std::vector<std::string> cells) { rows_.push_back(std::move(cells)); }

void Table::Print(std::ostream& out) const {
  std::vector<int> widths;
  for (std::size_t c = 0; c < columns_.size(); ++c) {
    std::size_t width = columns_[c].title.size();
    for (const auto& row : rows_) width = std::max(width, row[c].size());
    widths.push_back(static_cast<int>(width));
  }
  const auto print_row = [&](const auto& cell) {
    std::string line;
    for (std::size_t c = 0; c < columns_.size(); ++c) {
      const int width = columns_[c].align == Align::kRight ? widths[c] : -widths[c];
      absl::StrAppendFormat(&line, "%s%*s", c == 0 ? "" : "  ", width, cell(c));
    }
    line.erase(line.find_last_not_of(' ') + 1);
    out << line << '\n';
  };
  print_row([this](std::size_t c) { return columns_[c].title; });
  for (const auto& row : rows_) {
    print_row([&row](std::size_t c) { return row[c]; });
  }
}

std::string Fixed(double value, int decimals) { return absl::StrFormat("%.*f", decimals, value); }

}  // namespace soundmap::cli
