#include "motiongen/core/status.hpp"

namespace motiongen {

const char* name_of(Code code) {
  static const char* const kNames[] = {
      "OK",        "CANCELLED",      "UNKNOWN",           "INVALID_ARGUMENT",   "DEADLINE_EXCEEDED",
      "NOT_FOUND", "ALREADY_EXISTS", "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION",
      "ABORTED",   "OUT_OF_RANGE",   "UNIMPLEMENTED",     "INTERNAL",           "UNAVAILABLE",
      "DATA_LOSS", "UNAUTHENTICATED"};
  const auto number = static_cast<std::size_t>(code);
  return number < sizeof(kNames) / sizeof(*kNames) ? kNames[number] : "UNKNOWN";
}

Status invalid(const std::string& field, const std::string& given, const std::string& allowed) {
  return {Code::invalid_argument, "INVALID_INPUT", field + ": " + given + " was given; allowed is " + allowed};
}

Status violation(std::string message) { return {Code::internal, "PROTOCOL_VIOLATION", std::move(message)}; }

}  // namespace motiongen
