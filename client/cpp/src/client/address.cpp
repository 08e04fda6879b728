#include "client/address.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdlib>

namespace motiongen {
namespace {

constexpr char kUnix[] = "unix:";
constexpr std::size_t kUnixLength = sizeof kUnix - 1;
constexpr std::size_t kMostPathBytes = 107;  // of a socket on Linux; four less on macOS
constexpr char kDigits[] = "0123456789";
// gRPC does not recognise a path with any other character as a socket, and looks up a host of that name instead.
constexpr char kPathCharacters[] = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ/-._~!$&'()*+,;=:@";

bool is_socket(const std::string& address) { return address.compare(0, kUnixLength, kUnix) == 0; }

// A decimal whole number without a leading zero, which other parsers would read as octal; -1 for anything else.
long whole_number(const std::string& text) {
  const bool is_plain = !text.empty() && text.size() <= 5 && text.find_first_not_of(kDigits) == std::string::npos;
  if (!is_plain || (text.size() > 1 && text[0] == '0')) return -1;
  return std::strtol(text.c_str(), nullptr, 10);
}

// Whether a host can only be an IPv6 address without brackets. gRPC would take the port for its last part.
bool is_bare_v6(const std::string& host) {
  const bool has_colons = host.find(':') != host.rfind(':') || host == ":";
  return has_colons && host.find_first_not_of("0123456789abcdefABCDEF:.") == std::string::npos;
}

// 127.x.x.x
bool is_loopback_v4(const std::string& host) {
  std::size_t begin = 0;
  for (int part = 0; part < 4; ++part) {
    const std::size_t end = part == 3 ? host.size() : host.find('.', begin);
    if (end == std::string::npos) return false;
    const long number = whole_number(host.substr(begin, end - begin));
    if (number < 0 || number > 255 || (part == 0 && number != 127)) return false;
    begin = end + 1;
  }
  return true;
}

}  // namespace

Status check_address(const std::string& field, const std::string& address) {
  const std::string given = "\"" + address + "\"";
  if (is_socket(address)) {
    const std::string path = address.substr(kUnixLength);
    if (!path.empty() && path.size() <= kMostPathBytes && path.find_first_not_of(kPathCharacters) == std::string::npos)
      return {};
    return invalid(field, given,
                   "unix:PATH with a path of 1 to 107 bytes: letters, digits and any of /-._~!$&'()*+,;=:@");
  }
  const auto colon = address.rfind(':');
  const long port = colon == std::string::npos ? -1 : whole_number(address.substr(colon + 1));
  if (is_bare_v6(address.substr(0, colon))) {
    return invalid(field, given, "an IPv6 address in brackets, and its port, such as [::1]:50051");
  }
  if (colon != 0 && port >= 1 && port <= 65535) return {};
  return invalid(field, given, "host:port with a port from 1 to 65535, such as localhost:50051, or unix:PATH");
}

bool is_local(const std::string& address) {
  if (is_socket(address)) return true;
  const std::string host = address.substr(0, address.rfind(':'));
  return host == "localhost" || host == "[::1]" || is_loopback_v4(host);
}

std::string name_for_tls(const std::string& address) { return is_socket(address) ? "localhost" : ""; }

Status check_plain_token(const std::vector<std::string>& addresses) {
  const auto far = std::find_if_not(addresses.begin(), addresses.end(), is_local);
  if (far == addresses.end()) return {};
  return invalid("tls", "a token for \"" + *far + "\" without TLS",
                 "TLS where a token crosses the network, or an address of this machine: localhost, 127.0.0.1, [::1], "
                 "unix:PATH; set tls, or give no token");
}

}  // namespace motiongen
