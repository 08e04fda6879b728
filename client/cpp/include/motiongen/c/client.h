/* A client, and clips. */
#ifndef MOTIONGEN_C_CLIENT_H_
#define MOTIONGEN_C_CLIENT_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One stream to one server. Destroying it ends its sessions, whose handles stay to be destroyed. */
MOTIONGEN_C_API motiongen_code motiongen_client_connect(const motiongen_client_options* options,
                                                        motiongen_client** client, motiongen_error* error);
MOTIONGEN_C_API void motiongen_client_destroy(motiongen_client* client);
MOTIONGEN_C_API int32_t motiongen_client_is_connected(const motiongen_client* client);
/* 1 and the oldest event not taken, or 0 where there is none, and where `event` has no struct_size: none is lost. */
MOTIONGEN_C_API int32_t motiongen_client_next_event(motiongen_client* client, motiongen_event* event);

/* A clip: bounded motion, all samples in one call, which waits for them. Its handle outlives the client. */
MOTIONGEN_C_API motiongen_code motiongen_client_generate_clip(motiongen_client* client,
                                                              const motiongen_clip_options* options,
                                                              motiongen_clip** clip, motiongen_error* error);
MOTIONGEN_C_API void motiongen_clip_destroy(motiongen_clip* clip);
MOTIONGEN_C_API uint32_t motiongen_clip_num_samples(const motiongen_clip* clip);
MOTIONGEN_C_API uint32_t motiongen_clip_num_frames(const motiongen_clip* clip);
/* Rows of num_frames times row_floats numbers, which live as long as the clip; NULL for no sample. */
MOTIONGEN_C_API const float* motiongen_clip_rows(const motiongen_clip* clip, uint32_t sample, uint32_t* row_floats);
MOTIONGEN_C_API uint64_t motiongen_clip_seed(const motiongen_clip* clip, uint32_t sample);
MOTIONGEN_C_API motiongen_code motiongen_clip_residual(const motiongen_clip* clip, uint32_t sample, uint32_t target,
                                                       motiongen_residual* residual, motiongen_error* error);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_CLIENT_H_ */
