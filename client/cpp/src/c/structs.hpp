// Reads and writes the caller's structs: never more than the struct_size that the caller gave.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "motiongen/core/status.hpp"
#include "motiongen/motiongen.h"

namespace motiongen::c {

// Whether a struct of the caller can be read or written: it is not NULL and states its size.
template <class T>
bool has_size(const T* given) {
  return given != nullptr && given->struct_size >= sizeof given->struct_size;
}

// Read the caller's struct, with zeros for fields beyond its size. False if it is NULL or has no size.
template <class T>
bool read(const T* given, T& known) {
  std::memset(&known, 0, sizeof known);
  if (!has_size(given)) return false;
  std::memcpy(&known, given, std::min<std::size_t>(given->struct_size, sizeof known));
  return true;
}

// Write as much as the caller's struct has room for; its struct_size stays.
template <class T>
void write(T known, T* given) {
  if (!has_size(given)) return;
  known.struct_size = given->struct_size;
  std::memcpy(given, &known, std::min<std::size_t>(given->struct_size, sizeof known));
}

// Copy a text, truncated to fit but never in the middle of a UTF-8 character.
template <std::size_t N>
void copy_text(const std::string& text, char (&to)[N]) {
  std::size_t size = std::min(text.size(), N - 1);
  while (size < text.size() && size > 0 && (static_cast<unsigned char>(text[size]) & 0xC0U) == 0x80U) --size;
  std::memcpy(to, text.data(), size);
  to[size] = '\0';
}

// A call's return value; fills in `error` if the caller gave one.
inline motiongen_code answer(const Status& status, motiongen_error* error) {
  motiongen_error told;
  std::memset(&told, 0, sizeof told);
  told.code = static_cast<motiongen_code>(status.code());
  copy_text(status.reason(), told.reason);
  copy_text(status.message(), told.message);
  write(told, error);
  return told.code;
}

inline motiongen_code missing(const char* what, motiongen_error* error) {
  return answer(invalid(what, "NULL or a struct_size of 0", "a pointer to what the header says"), error);
}

inline Status not_open() { return {Code::failed_precondition, "NOT_OPEN", "the session has not opened yet"}; }

inline std::string text(const char* given) { return given == nullptr ? std::string() : std::string(given); }

}  // namespace motiongen::c
