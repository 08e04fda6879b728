// Arithmetic on frame rows: interpolation between two, and joint positions.
#pragma once

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"

namespace motiongen {

// The pose at the share `blend` (0 to 1) of the way from one frame to the next: linear interpolation of the root,
// spherical linear interpolation of rotations the shorter way round (Shoemake 1985), contacts and outputs of the nearer
// frame, linear interpolation of blocks that this library does not know. All rows have rig.row_width floats; `out` may
// be `from` or `to`.
MOTIONGEN_API void interpolate(const Rig& rig, Span<const float> from, Span<const float> to, float blend,
                               Span<float> out);

// World position of every joint by forward kinematics. row: rig.row_width floats; positions_m: 3 * J floats.
MOTIONGEN_API void joint_positions(const Rig& rig, Span<const float> row, Span<float> positions_m);

// The same, with the world rotation of every joint. rotations_wxyz: 4 * J floats.
MOTIONGEN_API void joint_transforms(const Rig& rig, Span<const float> row, Span<float> positions_m,
                                    Span<float> rotations_wxyz);

}  // namespace motiongen
