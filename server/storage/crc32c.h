#pragma once

#include <cstdint>
#include <string_view>

namespace soundmap::storage {

// CRC-32C (Castagnoli) as in RFC 3720. `previous` is the CRC of the bytes before these, so that
// parts add up to the whole.
std::uint32_t Crc32c(std::string_view bytes, std::uint32_t previous = 0);

}  // namespace soundmap::storage
