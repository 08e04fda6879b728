// Where a server is: host:port, or a socket of this machine.
#pragma once

#include <string>
#include <vector>

#include "motiongen/core/status.hpp"

namespace motiongen {

// host:port with a port from 1 to 65535, or unix:PATH. Else INVALID_ARGUMENT, with the name of the field.
Status check_address(const std::string& field, const std::string& address);

// Whether nothing that is sent there leaves this machine: localhost, 127.x.x.x, [::1] and unix:PATH.
bool is_local(const std::string& address);

// Whose certificate a server has to have where that does not go by its address: gRPC may look for the path of a socket
// among the names. Empty: by its address.
std::string name_for_tls(const std::string& address);

// INVALID_ARGUMENT where a token would cross a network in plain text.
Status check_plain_token(const std::vector<std::string>& addresses);

}  // namespace motiongen
