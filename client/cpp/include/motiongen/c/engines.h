/* Help for engines, without a session: steering, drawn paths, axes. */
#ifndef MOTIONGEN_C_ENGINES_H_
#define MOTIONGEN_C_ENGINES_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* World metres a second of a stick as the player sees it; right, forward: -1 to 1, camera_heading_rad: 0 toward +Z,
 * speed_mps: of a stick pushed all the way, dead_zone: what counts as let go, 0 to 1. */
MOTIONGEN_C_API motiongen_code motiongen_stick_velocity(float right, float forward, float camera_heading_rad,
                                                        float speed_mps, float dead_zone, float* x_mps, float* z_mps,
                                                        motiongen_error* error);
/* Corners (x z each, at most 256) of a line drawn through points_m (x z each), for a ROOT_PATH. corners_m has room for
 * 512 floats. */
MOTIONGEN_C_API motiongen_code motiongen_drawn_corners(const float* points_m, uint32_t num_points, float within_m,
                                                       float* corners_m, uint32_t* num_corners, motiongen_error* error);

enum { MOTIONGEN_AXES_UNREAL = 1, MOTIONGEN_AXES_UNITY = 2, MOTIONGEN_AXES_GODOT = 3, MOTIONGEN_AXES_ROS = 4 };

/* Into an engine's axes and units: positions x y z, and rotations w x y z -> x y z w. `out` may be `from`. */
MOTIONGEN_C_API motiongen_code motiongen_axes_positions(uint32_t axes, const float* from_m, float* out, uint32_t count,
                                                        motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_axes_rotations(uint32_t axes, const float* from_wxyz, float* out_xyzw,
                                                        uint32_t count, motiongen_error* error);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_ENGINES_H_ */
