// Checks of texts before they are sent to the server, so that an error fails one call only.
#pragma once

#include <cstddef>
#include <string>

#include "motiongen/core/status.hpp"

namespace motiongen {

// INVALID_ARGUMENT if the text is not UTF-8. No server can parse a message with such a text: it ends the stream, and
// with it all sessions.
Status check_utf8(const std::string& field, const std::string& text);

// INVALID_ARGUMENT for characters that a header must not have, for which gRPC would abort the program. The message does
// not contain the token.
Status check_token(const std::string& token);

// The longest beginning of a UTF-8 text that fits into `most` bytes without splitting a character.
std::string first_bytes(const std::string& text, std::size_t most);

}  // namespace motiongen
