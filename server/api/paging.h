#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace soundmap::api {

inline constexpr int kMaxPageSize = 1000;

// The size to use: all that fit when 0 is asked for. InvalidArgument: negative.
inline absl::StatusOr<int> PageSize(int asked_for) {
  if (asked_for < 0) return absl::InvalidArgumentError("page_size is negative");
  return asked_for == 0 ? kMaxPageSize : std::min(asked_for, kMaxPageSize);
}

// One page of a list that is at hand as a whole; the token is the position in it.
struct Page {
  std::size_t begin = 0;
  std::size_t end = 0;
  std::string next_token;  // empty: this is the last page
};
inline absl::StatusOr<Page> PageOf(std::size_t items, int page_size, const std::string& token) {
  const auto size = PageSize(page_size);
  if (!size.ok()) return size.status();
  Page page;
  if (!token.empty() && (!absl::SimpleAtoi(token, &page.begin) || page.begin > items)) {
    return absl::InvalidArgumentError(absl::StrCat("the page token '", token, "' is not ours"));
  }
  page.end = std::min(items, page.begin + static_cast<std::size_t>(*size));
  if (page.end < items) page.next_token = absl::StrCat(page.end);
  return page;
}

}  // namespace soundmap::api
