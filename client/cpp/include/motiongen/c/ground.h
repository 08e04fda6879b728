/* Motion is generated on a level floor at height 0; these functions adapt it to slopes and steps before it is shown. */
#ifndef MOTIONGEN_C_GROUND_H_
#define MOTIONGEN_C_GROUND_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Returns the ground's height in metres at world x, z. Called some 60 times a frame, from within the functions below;
 * it must use neither the session nor the ground. */
typedef double (*motiongen_heights)(void* context, double x_m, double z_m);
typedef struct motiongen_ground motiongen_ground;
/* For one session, which must have opened (FAILED_PRECONDITION before). Destroy it once nothing uses it any more. */
MOTIONGEN_C_API motiongen_code motiongen_ground_create(const motiongen_session* session, motiongen_heights heights,
                                                       void* context, motiongen_ground** ground,
                                                       motiongen_error* error);
MOTIONGEN_C_API void motiongen_ground_destroy(motiongen_ground* ground);
/* As motiongen_session_sample, on the ground. If it returns 0 because of an error, `error` describes it. */
MOTIONGEN_C_API int32_t motiongen_session_sample_on_ground(motiongen_session* session, motiongen_ground* ground,
                                                           float* row, uint32_t row_floats, motiongen_error* error);
/* Adapts all frames of a motion, such as a clip's, in place: num_rows rows of the session's rig. */
MOTIONGEN_C_API motiongen_code motiongen_ground_apply(motiongen_ground* ground, float* rows, uint32_t num_rows,
                                                      motiongen_error* error);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_GROUND_H_ */
