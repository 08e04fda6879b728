// Steering: a stick or a drawn line, as a player gives them, in the world's axes.
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
  float camera_heading_rad = 0;  // where the camera looks over the ground, 0 toward +Z
  float speed_mps = 3;           // of a stick pushed all the way
  float dead_zone = 0.15F;       // what counts as let go; beyond it speed begins at 0, so that nobody jumps into a walk
};

// World metres a second, for `Session::set_velocity`, of a stick as the player sees it. right, forward: -1 to 1; pushed
// into a corner it is no faster than along an axis. INVALID_ARGUMENT for numbers that are not finite and a dead zone
// outside of 0 to 1.
MOTIONGEN_API Result<GroundVector> stick_velocity(float right, float forward, const StickOptions& options = {});

// World x and z of a distance as the player sees it: to the right of where the camera looks, and ahead.
MOTIONGEN_API GroundVector camera_relative(float right_m, float forward_m, float camera_heading_rad);

// Corners, two numbers each and at most 256 of them, of a line drawn through points_m (x, z each), for a RootPath. No
// point is farther than within_m from the line through them (Ramer 1972, Douglas and Peucker 1973); where that takes
// more corners than a path may have, it is twice as far, and so on. INVALID_ARGUMENT for no point, numbers that are not
// finite and a within_m that is not above 0.
MOTIONGEN_API Result<std::vector<float>> drawn_corners(Span<const float> points_m, float within_m = 0.1F);

}  // namespace motiongen
