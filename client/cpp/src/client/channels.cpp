// gRPC's channels of a client, one for each address, and their settings.
#include "client/address.hpp"
#include "client/core.hpp"

namespace motiongen {
namespace {

void set_own(const ClientOptions& options, grpc::ChannelArguments& arguments) {
  const auto set = [&](const char* name, int value) {
    if (options.channel_options.count(name) == 0) arguments.SetInt(name, value);
  };
  set(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // each channel has its own connection
  set(GRPC_ARG_KEEPALIVE_TIME_MS, 30'000);
  set(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  set(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  set(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 5'000);  // in effect: how long one attempt may take
  set(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 2'000);
  // A window of fixed size: if gRPC sized it by its bandwidth estimate, minutes of motion would be buffered unread.
  set(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  set(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, 1 << 20);
  set(GRPC_ARG_ENABLE_RETRIES, 0);  // a stream has state, which a call repeated by gRPC would lack
  set(GRPC_ARG_MAX_RECEIVE_MESSAGE_LENGTH, 64 << 20);
  // A proxy set in the environment is another machine, and without TLS the token must stay on this one.
  if (!options.tls && has_token(options)) set(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
}

bool chooses_name(const ClientOptions& options) {
  return options.channel_options.count(GRPC_ARG_DEFAULT_AUTHORITY) != 0 ||
         options.channel_options.count(GRPC_SSL_TARGET_NAME_OVERRIDE_ARG) != 0;
}

}  // namespace

void ClientCore::make_channels() {
  grpc::ChannelArguments arguments;
  set_own(options_, arguments);
  for (const auto& [name, value] : options_.channel_options) {
    if (const int* number = std::get_if<int>(&value)) {
      arguments.SetInt(name, *number);
    } else {
      arguments.SetString(name, *std::get_if<std::string>(&value));
    }
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  if (options_.tls) {
    credentials = grpc::SslCredentials(
        {options_.root_certificates_pem, options_.private_key_pem, options_.certificate_chain_pem});
  }
  const auto add = [&](const std::string& address) {
    grpc::ChannelArguments own = arguments;
    const std::string name = options_.tls && !chooses_name(options_) ? name_for_tls(address) : "";
    if (!name.empty()) own.SetString(GRPC_ARG_DEFAULT_AUTHORITY, name);
    auto channel = grpc::CreateCustomChannel(address, credentials, own);
    auto stub = std::make_unique<grpc::GenericStub>(channel);
    servers_.push_back({std::move(channel), std::move(stub)});
  };
  add(options_.address);
  for (const std::string& address : options_.other_addresses) add(address);
}

}  // namespace motiongen
