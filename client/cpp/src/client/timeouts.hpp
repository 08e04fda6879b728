// Checks and bounds of timeouts.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "motiongen/core/status.hpp"

namespace motiongen {

// Three years, which stands for ever: a clock's nanosecond count overflows at little more.
inline constexpr double kLongestS = 1e8;

// INVALID_ARGUMENT for NaN.
inline Status check_timeout(double timeout_s) {
  if (!std::isnan(timeout_s)) return {};
  return invalid("timeout_s", "no number", "seconds; infinity waits for ever");
}

// A checked timeout, bounded to what clocks can represent.
inline double bounded_s(double timeout_s) { return std::clamp(timeout_s, 0.0, kLongestS); }

}  // namespace motiongen
