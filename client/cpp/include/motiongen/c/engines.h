/* Helpers for game engines that need no session: steering, drawn paths, axes. */
#ifndef MOTIONGEN_C_ENGINES_H_
#define MOTIONGEN_C_ENGINES_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Turns a stick's deflection, as the player sees it, into a world velocity. right, forward: -1 to 1;
 * camera_heading_rad: 0 toward +Z; speed_mps: the speed at full deflection; dead_zone: the deflection up to which the
 * stick counts as released, 0 to 1. */
MOTIONGEN_C_API motiongen_code motiongen_stick_velocity(float right, float forward, float camera_heading_rad,
                                                        float speed_mps, float dead_zone, float* x_mps, float* z_mps,
                                                        motiongen_error* error);
/* Simplifies a line drawn through points_m (x z each) to corners for a ROOT_PATH: at most 256 (x z each), so corners_m
 * needs room for 512 floats. within_m: how far the points may lie from the simplified line (core/steering.hpp). */
MOTIONGEN_C_API motiongen_code motiongen_drawn_corners(const float* points_m, uint32_t num_points, float within_m,
                                                       float* corners_m, uint32_t* num_corners, motiongen_error* error);

enum { MOTIONGEN_AXES_UNREAL = 1, MOTIONGEN_AXES_UNITY = 2, MOTIONGEN_AXES_GODOT = 3, MOTIONGEN_AXES_ROS = 4 };

/* Convert `count` positions (x y z) or rotations (w x y z -> x y z w) to an engine's axes and units. The output may
 * overwrite the input. */
MOTIONGEN_C_API motiongen_code motiongen_axes_positions(uint32_t axes, const float* from_m, float* out, uint32_t count,
                                                        motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_axes_rotations(uint32_t axes, const float* from_wxyz, float* out_xyzw,
                                                        uint32_t count, motiongen_error* error);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_ENGINES_H_ */
