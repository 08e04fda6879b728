#include "client/texts.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdio>

namespace motiongen {
namespace {

std::uint32_t byte_at(const std::string& text, std::size_t at) {
  return at < text.size() ? static_cast<unsigned char>(text[at]) : 0U;
}

bool continues(std::uint32_t byte) { return (byte & 0xC0U) == 0x80U; }

// The length in bytes of the character that begins at `at` (Unicode, table 3-7); 0 if it is not well-formed.
std::size_t character_bytes(const std::string& text, std::size_t at) {
  const std::uint32_t first = byte_at(text, at);
  if (first < 0x80) return 1;
  if (first < 0xC2 || first > 0xF4) return 0;
  // the second byte reveals overlong forms, UTF-16 surrogates and code points above U+10FFFF
  const std::uint32_t second = byte_at(text, at + 1);
  const std::uint32_t low = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
  const std::uint32_t high = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
  if (second < low || second > high) return 0;
  const std::size_t count = first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
  for (std::size_t byte = 2; byte < count; ++byte) {
    if (!continues(byte_at(text, at + byte))) return 0;
  }
  return count;
}

Status wrong_byte(const std::string& field, const std::string& text, std::size_t at, const std::string& allowed) {
  char byte[8];
  std::snprintf(byte, sizeof byte, "0x%02x", byte_at(text, at));
  const std::string place = std::to_string(at) + " of " + std::to_string(text.size());
  return invalid(field, std::string("the byte ") + byte + " at position " + place, allowed);
}

}  // namespace

Status check_utf8(const std::string& field, const std::string& text) {
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t count = character_bytes(text, at);
    if (count == 0) return wrong_byte(field, text, at, "UTF-8; convert what comes in another encoding");
    at += count;
  }
  return {};
}

Status check_token(const std::string& token) {
  const auto wrong = std::find_if(token.begin(), token.end(), [](char each) {
    const auto byte = static_cast<unsigned char>(each);
    return byte < 0x21 || byte > 0x7E;
  });
  if (wrong == token.end()) return {};
  return wrong_byte("token", token, static_cast<std::size_t>(wrong - token.begin()),
                    "printable ASCII without spaces (0x21 to 0x7e); a token from a file may have its line end, which "
                    "is to be taken off");
}

std::string first_bytes(const std::string& text, std::size_t most) {
  if (text.size() <= most) return text;
  std::size_t size = most;
  while (size > 0 && continues(byte_at(text, size))) --size;
  return text.substr(0, size);
}

}  // namespace motiongen
