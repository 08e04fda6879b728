/* A session: one character. */
#ifndef MOTIONGEN_C_SESSION_H_
#define MOTIONGEN_C_SESSION_H_

#include <stdint.h>

#include "motiongen/c/structs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Opens a session. Destroying its handle closes it. */
MOTIONGEN_C_API motiongen_code motiongen_client_open(motiongen_client* client, const motiongen_session_options* options,
                                                     motiongen_session** session, motiongen_error* error);
MOTIONGEN_C_API void motiongen_session_destroy(motiongen_session* session);
MOTIONGEN_C_API uint32_t motiongen_session_id(const motiongen_session* session);
MOTIONGEN_C_API int32_t motiongen_session_is_open(const motiongen_session* session);
MOTIONGEN_C_API motiongen_code motiongen_session_wait_open(motiongen_session* session, double timeout_s,
                                                           motiongen_error* error);

/* Edits. `edit`, where not NULL, receives the edit's number, which the answering event repeats. */
MOTIONGEN_C_API motiongen_code motiongen_session_set_prompt(motiongen_session* session, const char* text,
                                                            uint64_t* edit, motiongen_error* error);
/* In force from start_frame (0: as soon as possible) up to but not including end_frame (0: until another prompt takes
 * over). `id`, where not NULL, receives the id that the next two functions take; the present prompt's id is 1. */
MOTIONGEN_C_API motiongen_code motiongen_session_schedule_prompt(motiongen_session* session,
                                                                 const motiongen_prompt* prompt, uint64_t start_frame,
                                                                 uint64_t end_frame, uint32_t* id, uint64_t* edit,
                                                                 motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_replace_prompt(motiongen_session* session, uint32_t id,
                                                                const motiongen_prompt* prompt, uint64_t start_frame,
                                                                uint64_t end_frame, uint64_t* edit,
                                                                motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_remove_prompt(motiongen_session* session, uint32_t id, uint64_t* edit,
                                                               motiongen_error* error);
/* `id`, where not NULL, receives the id that replace_target, remove_target and placement take. */
MOTIONGEN_C_API motiongen_code motiongen_session_add_target(motiongen_session* session, const motiongen_target* target,
                                                            uint32_t* id, uint64_t* edit, motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_replace_target(motiongen_session* session, uint32_t id,
                                                                const motiongen_target* target, uint64_t* edit,
                                                                motiongen_error* error);
/* Where the server put a target. NOT_FOUND until the answer has arrived, and for a target that left nothing to the
 * server. */
MOTIONGEN_C_API motiongen_code motiongen_session_placement(const motiongen_session* session, uint32_t target,
                                                           motiongen_placement* placement, motiongen_error* error);
/* Walk to a ground position, however far away. relative: x_m is to the character's left, z_m ahead of it. */
MOTIONGEN_C_API motiongen_code motiongen_session_go_to(motiongen_session* session, float x_m, float z_m,
                                                       const float* heading_rad, int32_t relative, uint32_t* id,
                                                       uint64_t* edit, motiongen_error* error);
/* Stand at another place from the first frame that can still change. */
MOTIONGEN_C_API motiongen_code motiongen_session_teleport(motiongen_session* session, float x_m, float z_m,
                                                          float heading_rad, uint64_t* edit, motiongen_error* error);
/* Continue from the given frames, a whole number of patches. */
MOTIONGEN_C_API motiongen_code motiongen_session_cut_to(motiongen_session* session, const float* rows,
                                                        uint32_t num_rows, uint64_t* edit, motiongen_error* error);
/* Continue from one of the session's own frames, as if the frames before it had just been shown. */
MOTIONGEN_C_API motiongen_code motiongen_session_seek(motiongen_session* session, uint64_t frame, uint64_t* edit,
                                                      motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_set_options(motiongen_session* session,
                                                             const motiongen_options_change* change, uint64_t* edit,
                                                             motiongen_error* error);
/* heading_rad: NULL leaves it free. `id`, where not NULL, receives the id that motiongen_session_remove_target
 * takes. */
MOTIONGEN_C_API motiongen_code motiongen_session_add_waypoint(motiongen_session* session, uint64_t frame, float x_m,
                                                              float z_m, const float* heading_rad, uint32_t* id,
                                                              uint64_t* edit, motiongen_error* error);
/* positions_m: x and z of num_frames consecutive frames. */
MOTIONGEN_C_API motiongen_code motiongen_session_add_path(motiongen_session* session, uint64_t first_frame,
                                                          const float* positions_m, uint32_t num_frames, uint32_t* id,
                                                          uint64_t* edit, motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_remove_target(motiongen_session* session, uint32_t id, uint64_t* edit,
                                                               motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_clear_targets(motiongen_session* session, uint64_t* edit,
                                                               motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_set_velocity(motiongen_session* session, float x_mps, float z_mps,
                                                              double seconds, const float* heading_rad,
                                                              int32_t keep_prompt, uint64_t* edit,
                                                              motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_pause(motiongen_session* session, uint64_t* edit,
                                                       motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_resume(motiongen_session* session, uint64_t* edit,
                                                        motiongen_error* error);

/* The session's rig; FAILED_PRECONDITION until it has opened. Joint names live as long as the session's handle; the
 * name is NULL for an index that is no joint's. */
MOTIONGEN_C_API motiongen_code motiongen_session_rig(const motiongen_session* session, motiongen_rig* rig,
                                                     motiongen_error* error);
/* The column of a row at which a block or an output begins, by its name, such as "joint_positions_m". */
MOTIONGEN_C_API motiongen_code motiongen_session_block(const motiongen_session* session, const char* name,
                                                       uint32_t* column, motiongen_error* error);
MOTIONGEN_C_API const char* motiongen_session_joint_name(const motiongen_session* session, uint32_t joint);
MOTIONGEN_C_API int32_t motiongen_session_joint_parent(const motiongen_session* session,
                                                       uint32_t joint); /* -1: the root */

/* Frames. row: room for row_floats numbers, at least the rig's. Writes the pose for now, interpolated between two
 * frames, and returns 1; returns 0 and leaves row unchanged if there is none. */
MOTIONGEN_C_API int32_t motiongen_session_sample(motiongen_session* session, float* row, uint32_t row_floats);
MOTIONGEN_C_API motiongen_code motiongen_session_copy_frame(const motiongen_session* session, uint64_t frame,
                                                            float* row, uint32_t row_floats, motiongen_error* error);
/* Waits until the frame has arrived and, with manual_clock, may be shown. */
MOTIONGEN_C_API motiongen_code motiongen_session_wait_frame(motiongen_session* session, uint64_t frame,
                                                            double timeout_s, motiongen_error* error);
/* With manual_clock: show this frame. OUT_OF_RANGE with the reason FRAME_NOT_HELD if it is behind the playhead or has
 * not arrived yet, or EDIT_UNANSWERED if an edit that is not answered yet may replace it: try again later, or wait for
 * the frame. */
MOTIONGEN_C_API motiongen_code motiongen_session_advance_to(motiongen_session* session, uint64_t frame,
                                                            motiongen_error* error);
/* World positions of all joints of a row; positions_m: 3 floats a joint. */
MOTIONGEN_C_API motiongen_code motiongen_session_joint_positions(const motiongen_session* session, const float* row,
                                                                 float* positions_m, uint32_t num_floats,
                                                                 motiongen_error* error);
/* Play slower or faster than real time: 0.5 is half as fast. */
MOTIONGEN_C_API motiongen_code motiongen_session_set_time_scale(motiongen_session* session, double scale,
                                                                motiongen_error* error);
/* 1: the server saves the session, so that another server can continue it. */
MOTIONGEN_C_API int32_t motiongen_session_is_durable(const motiongen_session* session);
MOTIONGEN_C_API uint64_t motiongen_session_playhead(const motiongen_session* session);
MOTIONGEN_C_API uint64_t motiongen_session_buffered_to(const motiongen_session* session);
MOTIONGEN_C_API uint32_t motiongen_session_underruns(const motiongen_session* session);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_SESSION_H_ */
