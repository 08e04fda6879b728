#include "motiongen/core/axes.hpp"

#include <algorithm>
#include <cstddef>

namespace motiongen {
namespace {

// Our x points left, our y up and our z forward.
void turn(const Axes& axes, float x, float y, float z, float scale, float* to) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    to[axis] = scale * (axes.left[axis] * x + axes.up[axis] * y + axes.forward[axis] * z);
  }
}

}  // namespace

bool Axes::is_left_handed() const {
  const float across[3] = {up[1] * forward[2] - up[2] * forward[1], up[2] * forward[0] - up[0] * forward[2],
                           up[0] * forward[1] - up[1] * forward[0]};
  return left[0] * across[0] + left[1] * across[1] + left[2] * across[2] < 0;
}

void Axes::positions(Span<const float> from_m, Span<float> out) const {
  const std::size_t size = std::min(from_m.size(), out.size());
  for (std::size_t at = 0; at + 3 <= size; at += 3) {
    turn(*this, from_m[at], from_m[at + 1], from_m[at + 2], scale, &out[at]);
  }
}

void Axes::quaternions_xyzw(Span<const float> from_wxyz, Span<float> out) const {
  const std::size_t size = std::min(from_wxyz.size(), out.size());
  const float sign = is_left_handed() ? -1.0F : 1.0F;
  for (std::size_t at = 0; at + 4 <= size; at += 4) {
    const float w = from_wxyz[at];
    turn(*this, from_wxyz[at + 1], from_wxyz[at + 2], from_wxyz[at + 3], sign, &out[at]);
    out[at + 3] = w;
  }
}

}  // namespace motiongen
