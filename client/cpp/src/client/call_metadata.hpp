// What goes with each call beside its messages: who calls, the words of the application, and the key for proxies.
#pragma once

#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "motiongen/client/client.hpp"

namespace motiongen {

using Metadata = std::vector<std::pair<std::string, std::string>>;

// The reason of a call that was not made for want of a token.
inline constexpr char kTokenSource[] = "TOKEN_SOURCE";

// Metadata as gRPC takes it. INVALID_ARGUMENT for keys and texts that it does not, and for keys of other options.
Status check_metadata(const std::map<std::string, std::string>& metadata);

// May be used from any thread.
class CallMetadata {
 public:
  // options: outlive this.
  explicit CallMetadata(const ClientOptions& options) : options_(options) {}

  // For one call. Asks for the token, so no lock may be held. Where there is none the reason is TOKEN_SOURCE.
  Result<Metadata> make(const std::string& routing_key);

 private:
  Result<std::string> next_token();
  Result<std::string> ask_source();

  const ClientOptions& options_;
  std::mutex asking_;  // the source is asked by one thread at a time
};

}  // namespace motiongen
