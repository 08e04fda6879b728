#include "client/status_details.hpp"

#include "client/wire.hpp"

namespace motiongen {
namespace {

// Field numbers of google.rpc.Status, google.protobuf.Any and google.rpc.ErrorInfo.
constexpr std::uint32_t kDetails = 3;
constexpr std::uint32_t kTypeUrl = 1;
constexpr std::uint32_t kValue = 2;
constexpr std::uint32_t kReason = 1;

// The last length-delimited field with a number; an empty cursor if there is none.
wire::Cursor find(wire::Cursor message, std::uint32_t wanted) {
  wire::Cursor found;
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  while (message.left() > 0 && message.read_tag(field, type)) {
    if (field == wanted && type == wire::kLength) {
      if (!message.read_message(found)) return {};
    } else if (!message.skip_value(type)) {
      return {};
    }
  }
  return found;
}

std::string text(const wire::Cursor& cursor) {
  std::string read;
  return wire::gather(cursor, read) ? read : std::string();
}

std::string find_reason(const std::string& encoded) {
  const wire::Piece piece{reinterpret_cast<const std::uint8_t*>(encoded.data()), encoded.size()};
  wire::Cursor message(&piece, encoded.size());
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  while (message.left() > 0 && message.read_tag(field, type)) {
    wire::Cursor detail;
    if (field != kDetails || type != wire::kLength) {
      if (!message.skip_value(type)) break;
    } else if (!message.read_message(detail)) {
      break;
    } else if (text(find(detail, kTypeUrl)) == "type.googleapis.com/google.rpc.ErrorInfo") {
      return text(find(find(detail, kValue), kReason));
    }
  }
  return {};
}

}  // namespace

Status status_of(const grpc::Status& status) {
  if (status.ok()) return {};
  const int code = status.error_code();
  return {code > 0 && code <= 16 ? static_cast<Code>(code) : Code::unknown, find_reason(status.error_details()),
          status.error_message()};
}

}  // namespace motiongen
