#include "recording/wire.h"

#include <isa-l/crc.h>

#include <boost/endian/conversion.hpp>

namespace soundmap::recording {
namespace {

template <typename T>
void AppendLittle(std::string& out, T value) {
  char bytes[sizeof(T)];
  boost::endian::endian_store<T, sizeof(T), boost::endian::order::little>(
      reinterpret_cast<unsigned char*>(bytes), value);
  out.append(bytes, sizeof(T));
}

template <typename T>
T LoadLittle(std::string_view bytes) {
  if (bytes.size() < sizeof(T)) return 0;
  return boost::endian::endian_load<T, sizeof(T), boost::endian::order::little>(
      reinterpret_cast<const unsigned char*>(bytes.data()));
}

}  // namespace

std::uint32_t ExtendCrc32(std::uint32_t crc, std::string_view bytes) {
  return crc32_gzip_refl(crc, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
}

void AppendU16(std::string& out, std::uint16_t value) { AppendLittle(out, value); }
void AppendU32(std::string& out, std::uint32_t value) { AppendLittle(out, value); }
void AppendU64(std::string& out, std::uint64_t value) { AppendLittle(out, value); }

void AppendString(std::string& out, std::string_view value) {
  AppendU32(out, static_cast<std::uint32_t>(value.size()));
  out.append(value);
}

std::size_t BeginRecord(std::string& out, Opcode opcode) {
  const std::size_t position = out.size();
  out.push_back(static_cast<char>(opcode));
  AppendU64(out, 0);
  return position;
}

void EndRecord(std::string& out, std::size_t position) {
  boost::endian::store_little_u64(reinterpret_cast<unsigned char*>(out.data() + position + 1),
                                  out.size() - position - kRecordHeaderBytes);
}

std::uint8_t FieldParser::U8() { return LoadLittle<std::uint8_t>(Bytes(1)); }
std::uint16_t FieldParser::U16() { return LoadLittle<std::uint16_t>(Bytes(2)); }
std::uint32_t FieldParser::U32() { return LoadLittle<std::uint32_t>(Bytes(4)); }
std::uint64_t FieldParser::U64() { return LoadLittle<std::uint64_t>(Bytes(8)); }

std::string_view FieldParser::String() {
  const std::uint32_t length = U32();
  return Bytes(length);
}

std::string_view FieldParser::Bytes(std::uint64_t length) {
  if (!ok_ || length > rest_.size()) {
    ok_ = false;
    return {};
  }
  const std::string_view bytes = rest_.substr(0, length);
  rest_.remove_prefix(length);
  return bytes;
}

}  // namespace soundmap::recording
