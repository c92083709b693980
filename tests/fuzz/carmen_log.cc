#include "sources/convert/carmen_log.h"

#include <cmath>

#include "tests/fuzz/target.h"

namespace soundmap::fuzz {

std::vector<std::string> Seeds() {
  return {
      "PARAM robot_frontlaser_offset 0.1\n"
      "ODOM 0 0 0 0.1 0 0 1.0 host 1.0\n"
      "FLASER 4 1.0 2.0 3.0 81.9 0 0 0 0 0 0 1.1 host 1.1\n"
      "FLASER 4 1.0 2.0 3.0 81.9 0.1 0 0 0.1 0 0 1.2 host 1.2\n",
      "ROBOTLASER1 0 -1.57 3.14 1.0 81.9 0.01 0 3 1.0 2.0 3.0 0 0.1 0 0 0 0 0 0 0 0 0 0 1.0 host "
      "1.0\nRAWLASER1 0 -1.57 3.14 1.0 81.9 0.01 0 3 1.0 2.0 3.0 0 2.0 host 2.0\n"};
}

void Decode(std::string_view bytes) {
  convert::CarmenParser parser;
  int number = 0;
  for (std::size_t begin = 0; begin <= bytes.size();) {
    const std::size_t end = std::min(bytes.find('\n', begin), bytes.size());
    parser.Add(bytes.substr(begin, end - begin), ++number);
    begin = end + 1;
  }
  const auto log = parser.Finish(std::nullopt);
  if (!log.ok()) return;
  for (std::size_t i = 1; i < log->scans.size(); ++i) {
    Require(log->scans[i - 1].stamp_ns < log->scans[i].stamp_ns);
  }
  for (std::size_t i = 1; i < log->odometry.size(); ++i) {
    Require(log->odometry[i - 1].stamp_ns < log->odometry[i].stamp_ns);
  }
  Require(!log->scans.empty() && log->no_return_from_m > 0.0);
}

}  // namespace soundmap::fuzz
