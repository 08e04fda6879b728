// The metadata of each call: the token, the application's own metadata, and the key for proxies.
#pragma once

#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "motiongen/client/client.hpp"

namespace motiongen {

using Metadata = std::vector<std::pair<std::string, std::string>>;

// The reason of a call that was not made because there was no token.
inline constexpr char kTokenSource[] = "TOKEN_SOURCE";

// INVALID_ARGUMENT for keys and values that gRPC does not accept, and for keys of other options.
Status check_metadata(const std::map<std::string, std::string>& metadata);

// May be used from any thread.
class CallMetadata {
 public:
  // options: must outlive this object.
  explicit CallMetadata(const ClientOptions& options) : options_(options) {}

  // The metadata of one call. Calls the token source, so no lock may be held. Without a token, an error with the reason
  // TOKEN_SOURCE.
  Result<Metadata> make(const std::string& routing_key);

 private:
  Result<std::string> next_token();
  Result<std::string> ask_source();

  const ClientOptions& options_;
  std::mutex asking_;  // one thread at a time calls the source
};

}  // namespace motiongen
