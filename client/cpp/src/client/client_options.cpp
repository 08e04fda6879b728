// What is wrong with the options of a client.
#include "client/core.hpp"
#include "client/texts.hpp"

namespace motiongen {

Status ClientCore::check_options() const {
  std::vector<std::string> addresses = options_.other_addresses;
  addresses.insert(addresses.begin(), options_.address);
  for (const std::string& address : addresses) {
    const auto colon = address.rfind(':');
    if (colon == std::string::npos || colon == 0 || colon + 1 == address.size()) {
      return invalid("address", "\"" + address + "\"", "host:port, such as localhost:50051");
    }
  }
  if (!(options_.report_hz >= 1 && options_.report_hz <= 5)) {
    return invalid("report_hz", std::to_string(options_.report_hz), "a number from 1 to 5");
  }
  if (!(options_.ping_period_s >= 0.1 && options_.ping_period_s <= 60)) {
    return invalid("ping_period_s", std::to_string(options_.ping_period_s), "a number from 0.1 to 60");
  }
  if (!(options_.flush_interval_s >= 0.005 && options_.flush_interval_s <= 0.1)) {
    return invalid("flush_interval_s", std::to_string(options_.flush_interval_s), "a number from 0.005 to 0.1");
  }
  if (!Route::is_key(options_.routing_key)) {
    return invalid("routing_key", "\"" + options_.routing_key + "\"", "letters, digits, -, . and _");
  }
  if (!(options_.connect_timeout_s > 0)) {
    return invalid("connect_timeout_s", std::to_string(options_.connect_timeout_s), "a number above 0");
  }
  Status checked = check_token(options_.token);
  return checked ? check_utf8("agent", options_.agent) : checked;
}

}  // namespace motiongen
