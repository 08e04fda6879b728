// Converts poses to the axes of game engines and robots.
#pragma once

#include "motiongen/core/export.hpp"
#include "motiongen/core/span.hpp"

namespace motiongen {

// How an engine's axes relate to ours, which are right-handed: +Y up, +Z forward, +X to the character's left, metres. A
// change of axes A maps every position p to scale * A p, and every rotation R, whether of the root or of a joint
// relative to its parent, to A R A^T. The axis of a rotation is an axial vector: a quaternion (w, v) becomes (w, det(A)
// A v).
struct MOTIONGEN_API Axes {
  // Our directions in the engine's axes: x, y, z, one of them 1 or -1 and the others 0.
  float forward[3];
  float up[3];
  float left[3];
  float scale;  // the engine's units in a metre

  bool is_left_handed() const;
  // 3 numbers a position, our metres -> the engine's units. Also converts a rig's offsets. `out` may be `from`.
  void positions(Span<const float> from_m, Span<float> out) const;
  // 4 numbers a rotation, our w x y z -> x y z w, the order of Unreal, Unity, Godot and ROS. `out` may be `from`.
  void quaternions_xyzw(Span<const float> from_wxyz, Span<float> out) const;
};

// Left-handed, +X forward, +Y right, +Z up, centimetres.
inline constexpr Axes kUnreal = {{1, 0, 0}, {0, 0, 1}, {0, -1, 0}, 100};
// Left-handed, +Z forward, +X right, +Y up.
inline constexpr Axes kUnity = {{0, 0, 1}, {0, 1, 0}, {-1, 0, 0}, 1};
// Right-handed, -Z forward (Vector3.FORWARD), +X right, +Y up.
inline constexpr Axes kGodot = {{0, 0, -1}, {0, 1, 0}, {-1, 0, 0}, 1};
// Right-handed, +X forward, +Y left, +Z up (REP 103).
inline constexpr Axes kRos = {{1, 0, 0}, {0, 0, 1}, {0, 1, 0}, 1};

}  // namespace motiongen
