#include "storage/crc32c.h"

#include <isa-l/crc.h>

#include <algorithm>

namespace soundmap::storage {

std::uint32_t Crc32c(std::string_view bytes, std::uint32_t previous) {
  constexpr std::size_t kPart = 1 << 30;  // ISA-L takes lengths as int
  std::uint32_t remainder = ~previous;
  while (!bytes.empty()) {
    const std::string_view part = bytes.substr(0, kPart);
    // ISA-L reads only, although it asks for a pointer to non-const.
    remainder =
        crc32_iscsi(reinterpret_cast<unsigned char*>(const_cast<char*>(part.data())),  // NOLINT
                    static_cast<int>(part.size()), remainder);
    bytes.remove_prefix(part.size());
  }
  return ~remainder;
}

}  // namespace soundmap::storage
