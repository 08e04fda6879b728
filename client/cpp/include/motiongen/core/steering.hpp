// Steering: turns a player's stick or drawn line into velocities and paths in world axes.
#pragma once

#include <cstdint>
#include <vector>

#include "motiongen/core/export.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

struct GroundVector {
  float x = 0;
  float z = 0;
};

struct StickOptions {
  float camera_heading_rad = 0;  // the camera's direction over the ground, 0 toward +Z
  float speed_mps = 3;           // at full deflection
  float dead_zone = 0.15F;       // deflection that counts as released; beyond it speed rises from 0, without a jump
};

// The world velocity, metres a second, for `Session::set_velocity`, of a stick as the player sees it. right, forward:
// -1 to 1; a diagonal is no faster than an axis. INVALID_ARGUMENT for numbers that are not finite and for a dead zone
// outside 0 to 1.
MOTIONGEN_API Result<GroundVector> stick_velocity(float right, float forward, const StickOptions& options = {});

// World x and z of a distance as the player sees it: to the right of the camera's direction, and ahead.
MOTIONGEN_API GroundVector camera_relative(float right_m, float forward_m, float camera_heading_rad);

// Simplifies a line drawn through points_m (x, z each) to corners for a RootPath, two numbers each and at most 256 of
// them. No point lies farther than within_m from the line through the corners (Ramer 1972, Douglas and Peucker 1973);
// if that takes more corners than a path may have, within_m is doubled until it does not. INVALID_ARGUMENT for no
// points, numbers that are not finite and a within_m that is not above 0.
MOTIONGEN_API Result<std::vector<float>> drawn_corners(Span<const float> points_m, float within_m = 0.1F);

}  // namespace motiongen
