// The result of a call: OK or an error to act on. Nothing in this library throws.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <string>
#include <utility>
#include <variant>

#include "motiongen/core/export.hpp"

namespace motiongen {

// The numbers are those of google.rpc.Code.
enum class Code : std::int32_t {
  ok = 0,
  cancelled = 1,
  unknown = 2,
  invalid_argument = 3,
  deadline_exceeded = 4,
  not_found = 5,
  already_exists = 6,
  permission_denied = 7,
  resource_exhausted = 8,
  failed_precondition = 9,
  aborted = 10,
  out_of_range = 11,
  unimplemented = 12,
  internal = 13,
  unavailable = 14,
  data_loss = 15,
  unauthenticated = 16,
};

// Such as "INVALID_ARGUMENT"; "UNKNOWN" for a number that is no code.
MOTIONGEN_API const char* name_of(Code code);

// Converts to true if the call did what it was asked for.
class [[nodiscard]] Status {
 public:
  Status() = default;
  // reason: a stable name in UPPER_SNAKE_CASE, of the library or of a server's refusal. message: for people: what was
  // given, what is allowed and what to do.
  Status(Code code, std::string reason, std::string message)
      : code_(code), reason_(std::move(reason)), message_(std::move(message)) {}

  explicit operator bool() const { return code_ == Code::ok; }
  bool ok() const { return code_ == Code::ok; }
  Code code() const { return code_; }
  const std::string& reason() const { return reason_; }
  const std::string& message() const { return message_; }

 private:
  Code code_ = Code::ok;
  std::string reason_;
  std::string message_;
};

// INVALID_ARGUMENT: what was given and what is allowed. Nothing was done.
MOTIONGEN_API Status invalid(const std::string& field, const std::string& given, const std::string& allowed);

// The server broke a rule of the protocol. Not the caller's error: report it with the server's version.
MOTIONGEN_API Status violation(std::string message);

// A value, or the status that says why there is none.
template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : held_(std::in_place_index<1>, std::move(value)) {}         // NOLINT: converts on purpose
  Result(Status status) : held_(std::in_place_index<0>, std::move(status)) {}  // NOLINT: converts on purpose

  explicit operator bool() const { return held_.index() == 1; }
  bool ok() const { return held_.index() == 1; }
  const Status& status() const {
    static const Status none;
    return ok() ? none : *std::get_if<0>(&held_);
  }
  // Aborts the program if there is no value: test first.
  T& value() & { return ok() ? *std::get_if<1>(&held_) : (std::abort(), *std::get_if<1>(&held_)); }
  const T& value() const& { return ok() ? *std::get_if<1>(&held_) : (std::abort(), *std::get_if<1>(&held_)); }
  T&& value() && { return std::move(value()); }
  T& operator*() & { return value(); }
  T* operator->() { return &value(); }

 private:
  std::variant<Status, T> held_;
};

}  // namespace motiongen
