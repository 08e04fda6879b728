// How long may be waited for.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "motiongen/core/status.hpp"

namespace motiongen {

// Three years, which stands for ever: a clock's count of nanoseconds has no room for much more.
inline constexpr double kLongestS = 1e8;

// INVALID_ARGUMENT for what is no number.
inline Status check_timeout(double timeout_s) {
  if (!std::isnan(timeout_s)) return {};
  return invalid("timeout_s", "no number", "seconds; infinity waits for ever");
}

// A timeout that was checked, as clocks can take it.
inline double bounded_s(double timeout_s) { return std::clamp(timeout_s, 0.0, kLongestS); }

}  // namespace motiongen
