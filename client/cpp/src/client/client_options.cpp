// Checks of a client's options.
#include <utility>

#include "client/address.hpp"
#include "client/core.hpp"
#include "client/texts.hpp"

namespace motiongen {
namespace {

constexpr char kOfGrpc[] = "grpc.";
constexpr char kUserAgent[] = "grpc.primary_user_agent";
constexpr char kProxies[] = "grpc.enable_http_proxy";

Status check_channel_options(const ClientOptions& options) {
  for (const auto& [name, value] : options.channel_options) {
    static_cast<void>(value);
    const std::string given = "\"" + name + "\"";
    if (name.rfind(kOfGrpc, 0) != 0) {
      return invalid("channel_options", given, "names of gRPC's, which begin with \"grpc.\"");
    }
    if (name == kUserAgent) return invalid("channel_options", given, "any other; `agent` says who calls");
    if (name == kProxies && !options.tls && has_token(options)) {
      return invalid("channel_options", given, "any other beside a token without TLS, which goes to no proxy");
    }
  }
  return {};
}

Status check_token_of(const ClientOptions& options) {
  if (options.token_source && !options.token.empty()) {
    return invalid("token_source", "a source beside a token", "one of the two");
  }
  Status checked = check_token(options.token);
  if (!checked || options.tls || !has_token(options)) return checked;
  return check_plain_token(addresses_of(options));
}

// gRPC takes what it cannot read for no certificate at all, and connects to nothing.
Status check_certificates(const ClientOptions& options) {
  const std::pair<const char*, const std::string*> texts[] = {{"root_certificates_pem", &options.root_certificates_pem},
                                                              {"certificate_chain_pem", &options.certificate_chain_pem},
                                                              {"private_key_pem", &options.private_key_pem}};
  for (const auto& [field, text] : texts) {
    if (text->empty()) continue;
    if (!options.tls) return invalid(field, "a text without tls", "tls = true beside it, or no text");
    if (text->find("-----BEGIN ") == std::string::npos) {  // not quoted: it may be secret
      return invalid(field, "a text of " + std::to_string(text->size()) + " bytes that is no PEM",
                     "what a PEM file contains, not its path");
    }
  }
  if (options.certificate_chain_pem.empty() == options.private_key_pem.empty()) return {};
  return invalid("certificate_chain_pem, private_key_pem", "one of them", "both, or neither");
}

}  // namespace

bool has_token(const ClientOptions& options) { return !options.token.empty() || options.token_source; }

std::vector<std::string> addresses_of(const ClientOptions& options) {
  std::vector<std::string> addresses = options.other_addresses;
  addresses.insert(addresses.begin(), options.address);
  return addresses;
}

Status ClientCore::check_options() const {
  for (const std::string& address : addresses_of(options_)) {
    Status checked = check_address("address", address);
    if (!checked) return checked;
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
  Status checked = check_certificates(options_);
  if (checked) checked = check_token_of(options_);
  if (checked) checked = check_metadata(options_.metadata);
  if (checked) checked = check_channel_options(options_);
  return checked ? check_utf8("agent", options_.agent) : checked;
}

}  // namespace motiongen
