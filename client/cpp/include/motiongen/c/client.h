/* Clients and clips. */
#ifndef MOTIONGEN_C_CLIENT_H_
#define MOTIONGEN_C_CLIENT_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A client is one stream to one server. Destroying it ends its sessions; their handles must still be destroyed. */
MOTIONGEN_C_API motiongen_code motiongen_client_connect(const motiongen_client_options* options,
                                                        motiongen_client** client, motiongen_error* error);
MOTIONGEN_C_API void motiongen_client_destroy(motiongen_client* client);
MOTIONGEN_C_API int32_t motiongen_client_is_connected(const motiongen_client* client);
/* Writes the oldest event not yet taken and returns 1. Returns 0 if there is none, or if `event` has no struct_size; no
 * event is lost then. */
MOTIONGEN_C_API int32_t motiongen_client_next_event(motiongen_client* client, motiongen_event* event);

/* Generates a clip: bounded motion, all samples in one call, which blocks until they are ready. The clip's handle may
 * outlive the client. */
MOTIONGEN_C_API motiongen_code motiongen_client_generate_clip(motiongen_client* client,
                                                              const motiongen_clip_options* options,
                                                              motiongen_clip** clip, motiongen_error* error);
MOTIONGEN_C_API void motiongen_clip_destroy(motiongen_clip* clip);
MOTIONGEN_C_API uint32_t motiongen_clip_num_samples(const motiongen_clip* clip);
MOTIONGEN_C_API uint32_t motiongen_clip_num_frames(const motiongen_clip* clip);
/* The frame rows of a sample: num_frames * row_floats numbers, valid as long as the clip. NULL if there is no such
 * sample. */
MOTIONGEN_C_API const float* motiongen_clip_rows(const motiongen_clip* clip, uint32_t sample, uint32_t* row_floats);
MOTIONGEN_C_API uint64_t motiongen_clip_seed(const motiongen_clip* clip, uint32_t sample);
MOTIONGEN_C_API motiongen_code motiongen_clip_residual(const motiongen_clip* clip, uint32_t sample, uint32_t target,
                                                       motiongen_residual* residual, motiongen_error* error);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_CLIENT_H_ */
