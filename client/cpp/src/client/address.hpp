// Addresses of servers: host:port, or a socket of this machine.
#pragma once

#include <string>
#include <vector>

#include "motiongen/core/status.hpp"

namespace motiongen {

// Accepts host:port with a port from 1 to 65535, or unix:PATH. Otherwise INVALID_ARGUMENT, which names the field.
Status check_address(const std::string& field, const std::string& address);

// Whether the address is on this machine: localhost, 127.x.x.x, [::1] or unix:PATH.
bool is_local(const std::string& address);

// The name that the server's certificate must have where it is not that of the address: for a socket, gRPC might look
// for its path among the names. Empty: that of the address.
std::string name_for_tls(const std::string& address);

// INVALID_ARGUMENT if a token would cross a network in plain text.
Status check_plain_token(const std::vector<std::string>& addresses);

}  // namespace motiongen
