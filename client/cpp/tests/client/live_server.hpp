// Options for tests against a real server, whose address is in MOTIONGEN_ADDRESS.
#pragma once

#include <cstdlib>

#include "motiongen/client/client.hpp"

namespace motiongen {

inline constexpr double kLimitS = 60;

inline ClientOptions server() {
  const char* address = std::getenv("MOTIONGEN_ADDRESS");
  ClientOptions options;
  options.address = address == nullptr ? "" : address;
  options.connect_timeout_s = kLimitS;
  return options;
}

inline SessionOptions walking() {
  SessionOptions options;
  options.prompt = "a person walks forward";
  options.seed = 3;
  options.clock = Clock::manual;
  return options;
}

}  // namespace motiongen
