// Texts on their way to the server: what is wrong with them is told here, where it costs one call alone.
#pragma once

#include <cstddef>
#include <string>

#include "motiongen/core/status.hpp"

namespace motiongen {

// INVALID_ARGUMENT for what is not UTF-8. No server can read a message with such a text: it ends the stream, and with
// it all sessions.
Status check_utf8(const std::string& field, const std::string& text);

// INVALID_ARGUMENT for what no header may have, since gRPC ends the program over it. The token itself stays secret.
Status check_token(const std::string& token);

// As much of a UTF-8 text as so many bytes hold, never half a character.
std::string first_bytes(const std::string& text, std::size_t most);

}  // namespace motiongen
