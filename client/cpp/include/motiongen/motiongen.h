/* motiongen for engines: a C interface whose structs may grow. Compiles as C99 and as C++.
 *
 * Every struct begins with struct_size, which the caller sets to its sizeof; what lies beyond it was not known to the
 * caller, is taken as 0 and is not written. In options 0 and NULL leave a choice to the library or to the server.
 * Functions that can fail return a motiongen_code and, where `error` is not NULL, say there what was given and what is
 * allowed. Texts are UTF-8. Frames count from 0 at the start of a session; axes and units are those of docs/motion.md:
 * right-handed, +Y up, +Z forward, metres, radians, quaternions w x y z. Any function may be called from any thread; a
 * handle must not be used while it is destroyed, nor after. */
#ifndef MOTIONGEN_MOTIONGEN_H_
#define MOTIONGEN_MOTIONGEN_H_

#include <stdint.h>

#if defined(_WIN32)
#define MOTIONGEN_C_API __declspec(dllexport)
#else
#define MOTIONGEN_C_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define MOTIONGEN_ABI_VERSION 1u

/* Of the library that is loaded; functions are added, never changed, while this stays. */
MOTIONGEN_C_API uint32_t motiongen_abi_version(void);

/* Numbers of google.rpc.Code. */
typedef int32_t motiongen_code;
enum {
  MOTIONGEN_OK = 0,
  MOTIONGEN_INVALID_ARGUMENT = 3,
  MOTIONGEN_DEADLINE_EXCEEDED = 4,
  MOTIONGEN_NOT_FOUND = 5,
  MOTIONGEN_RESOURCE_EXHAUSTED = 8,
  MOTIONGEN_FAILED_PRECONDITION = 9,
  MOTIONGEN_OUT_OF_RANGE = 11,
  MOTIONGEN_INTERNAL = 13,
  MOTIONGEN_UNAVAILABLE = 14
};

typedef struct motiongen_client motiongen_client;
typedef struct motiongen_session motiongen_session;

typedef struct motiongen_error {
  uint32_t struct_size;
  motiongen_code code;
  char reason[64];   /* a stable name, UPPER_SNAKE_CASE, or "" */
  char message[512]; /* for people; cut off where it is longer */
} motiongen_error;

typedef struct motiongen_client_options {
  uint32_t struct_size;
  uint32_t use_tls;    /* 1: TLS with root_certificates_pem, or the system's where that is NULL */
  const char* address; /* host:port */
  const char* token;   /* NULL: none */
  const char* root_certificates_pem;
  double connect_timeout_s; /* 0: 10 s */
  uint32_t no_reconnect;    /* 1: sessions end when the stream is lost */
  uint32_t num_other_addresses;
  const char* const* other_addresses; /* of servers that share a store of sessions, tried in turn */
  const char* certificate_chain_pem;  /* of this client, where the server asks for one; with private_key_pem */
  const char* private_key_pem;
} motiongen_client_options;

/* How frames are stored on their way here. */
enum { MOTIONGEN_FORMAT_F32 = 1, MOTIONGEN_FORMAT_F16 = 2, MOTIONGEN_FORMAT_QUANTISED = 3 };

typedef struct motiongen_session_options {
  uint32_t struct_size;
  uint32_t priority;  /* 1 hero, 2 near, 3 crowd, 4 batch; 0: near */
  const char* prompt; /* NULL: none */
  const char* model_id;
  uint64_t seed;
  uint32_t has_seed;
  uint32_t lookahead_frames;
  uint32_t denoise_steps;
  uint32_t manual_clock; /* 1: motiongen_session_advance_to moves the playhead; 0: real time does */
  float start_x_m;
  float start_z_m;
  float start_heading_rad;
  uint32_t frame_format; /* 0: F32 */
  uint32_t history_frames;
  uint32_t keep_prompts;   /* 1: prompts hold also where targets ask for a pace that they contradict */
  const char* preset_id;   /* a prompt of the catalogue in place of `prompt` */
  const float* prior_rows; /* what it did just before frame 0: num_prior_rows rows of the rig */
  uint32_t num_prior_rows;
  uint32_t prior_row_floats; /* of each */
  float text_guidance;       /* with has_text_guidance, as the next */
  float target_guidance;
  uint32_t has_text_guidance;
  uint32_t has_target_guidance;
  const char* const* outputs; /* what each row shall have besides: motiongen_session_block tells where */
  uint32_t num_outputs;
} motiongen_session_options;

typedef struct motiongen_rig {
  uint32_t struct_size;
  uint32_t num_joints;
  uint32_t row_floats; /* of a frame row */
  uint32_t frame_rate_hz;
  uint32_t root_column;     /* 3 floats */
  uint32_t rotation_column; /* 4 floats a joint, relative to its parent */
  uint32_t contact_column;  /* 4 floats: left heel, left toe, right heel, right toe */
} motiongen_rig;

enum {
  MOTIONGEN_EVENT_OPENED = 1,
  MOTIONGEN_EVENT_EDIT = 2,
  MOTIONGEN_EVENT_SERVICE_LEVEL = 3,
  MOTIONGEN_EVENT_CLOSED = 4,
  MOTIONGEN_EVENT_CONNECTION_LOST = 5,
  MOTIONGEN_EVENT_CONNECTED = 6,
  MOTIONGEN_EVENT_RECOVERED = 7,
  MOTIONGEN_EVENT_DRAINING = 8,
  MOTIONGEN_EVENT_REACHED = 9,    /* a target was met or missed; its last frame can change no more */
  MOTIONGEN_EVENT_DURABILITY = 10 /* whether another server could go on with the session has changed */
};

typedef struct motiongen_event {
  uint32_t struct_size;
  uint32_t kind;
  uint32_t session;    /* motiongen_session_id; 0: about the connection */
  motiongen_code code; /* of the answer to an edit, of a close, of a loss */
  uint64_t edit;
  uint64_t frame; /* EDIT: the first it shows at; RECOVERED: the first that is new */
  uint32_t has_frame;
  uint32_t exact; /* RECOVERED: 1 where the motion is the same as without the loss */
  uint32_t tier;  /* SERVICE_LEVEL: 1 full, 2 fewer steps, 3 no guidance, 5 holds its pose */
  uint32_t denoise_steps;
  char reason[64];
  char message[512];
  uint32_t target; /* REACHED: which, and the five below; its frame is in `frame` */
  uint32_t met;    /* 1: within its tolerances */
  uint32_t has_position_error;
  float position_error_m;
  uint32_t has_rotation_error;
  float rotation_error_rad;
  uint32_t is_durable; /* DURABILITY */
  uint32_t reserved;
} motiongen_event;

/* A text, or a preset by its id, or the vector of a text encoder, whose text is for people. */
typedef struct motiongen_prompt {
  uint32_t struct_size;
  uint32_t num_embedding;
  const char* text;
  const char* preset_id;
  const char* text_encoder;
  const float* embedding;
} motiongen_prompt;

enum {
  MOTIONGEN_TARGET_WAYPOINT = 1,        /* x_m, z_m, perhaps heading_rad */
  MOTIONGEN_TARGET_ROOT_TRAJECTORY = 2, /* positions_m: x z of consecutive frames; perhaps headings_rad */
  MOTIONGEN_TARGET_KEYFRAME = 3,        /* positions_m: x y z of every joint */
  MOTIONGEN_TARGET_JOINTS = 4,          /* joints, positions_m: x y z of each; perhaps rotations_wxyz */
  MOTIONGEN_TARGET_HEADING = 5,         /* heading_rad */
  MOTIONGEN_TARGET_JOINT_ROTATIONS = 6, /* joints, rotations_wxyz */
  MOTIONGEN_TARGET_ROOT_PATH = 7,       /* positions_m: x z of each corner; perhaps speed_mps, smoothing_m */
  MOTIONGEN_TARGET_FOOT_CONTACT = 8     /* limb, x_m, z_m, perhaps heading_rad */
};

/* Where a character shall be and when; client/targets.hpp says more of each form. */
typedef struct motiongen_target {
  uint32_t struct_size;
  uint32_t form;
  uint64_t frame; /* 0 for a path and with at_any_frame */
  uint64_t last_frame;
  uint32_t has_last_frame;        /* 1: it may be met at any frame up to last_frame */
  uint32_t at_any_frame;          /* 1: as soon as a person can be there */
  uint32_t frames_from_effect;    /* 1: frames count from when the change takes effect */
  uint32_t relative_to_character; /* 1: seen from the character then: x to its left, z ahead */
  float weight;                   /* above 0, at most 10; 0: 1, it must be */
  float x_m;
  float z_m;
  float heading_rad;
  uint32_t has_heading;
  uint32_t num_positions; /* of 2 or 3 floats each */
  const float* positions_m;
  const float* headings_rad; /* one a position; NULL leaves them free */
  const uint32_t* joints;
  const float* rotations_wxyz; /* one a joint; NULL leaves them free */
  uint32_t num_joints;
  float tolerance_m; /* with has_tolerance_m, as the next; else the model's */
  float tolerance_rad;
  uint32_t has_tolerance_m;
  uint32_t has_tolerance_rad;
  float speed_mps; /* 0: 1.2 */
  float smoothing_m;
  uint32_t has_smoothing; /* else 0.3 */
  const char* limb;       /* LeftFoot or RightFoot */
} motiongen_target;

/* Where a target was put that left that to the server. */
typedef struct motiongen_placement {
  uint32_t struct_size;
  uint32_t target;
  uint64_t first_frame;
  uint64_t last_frame;
  uint64_t arrival_frame; /* the one that is aimed for */
  uint64_t anchor_frame;  /* at which it takes effect, and the character just before: */
  float anchor_x_m;
  float anchor_z_m;
  float anchor_heading_rad;
  uint32_t reserved;
} motiongen_placement;

/* What changes of an open session; 0 leaves it. */
typedef struct motiongen_options_change {
  uint32_t struct_size;
  uint32_t priority;
  uint32_t lookahead_frames;
  uint32_t denoise_steps;
  uint32_t history_frames;
  uint32_t has_guidance; /* 1: both weights are set anew, what has no has_ to the model's own */
  float text_guidance;
  float target_guidance;
  uint32_t has_text_guidance;
  uint32_t has_target_guidance;
} motiongen_options_change;

/* An element of an array; never changed. */
typedef struct motiongen_waypoint {
  uint64_t frame;
  float x_m;
  float z_m;
  float heading_rad;
  uint32_t has_heading;
} motiongen_waypoint;

typedef struct motiongen_clip_options {
  uint32_t struct_size;
  uint32_t num_frames;  /* 1 or more; the server has a limit */
  uint32_t num_samples; /* 0: one; sample n has the seed + n */
  uint32_t denoise_steps;
  const char* prompt; /* NULL: none */
  const char* model_id;
  uint64_t seed;
  uint32_t has_seed;
  uint32_t num_waypoints;
  const motiongen_waypoint* waypoints;
  double timeout_s; /* 0: 60 s */
  float start_x_m;
  float start_z_m;
  float start_heading_rad;
  uint32_t num_targets;
  const motiongen_target* const* targets; /* their residuals follow those of the waypoints */
} motiongen_clip_options;

/* How near the motion came to one target, each measured alone; the greatest errors. */
typedef struct motiongen_residual {
  uint32_t struct_size;
  uint32_t num_frames; /* of it that are in the clip; 0: nothing was measured */
  uint32_t met;
  uint32_t has_position;
  float position_m;
  uint32_t has_heading;
  float heading_rad;
  uint32_t has_rotation;
  float rotation_rad;
} motiongen_residual;

typedef struct motiongen_clip motiongen_clip;

/* ---- a client: one stream to one server. Destroying it ends its sessions, whose handles stay to be destroyed. */
MOTIONGEN_C_API motiongen_code motiongen_client_connect(const motiongen_client_options* options,
                                                        motiongen_client** client, motiongen_error* error);
MOTIONGEN_C_API void motiongen_client_destroy(motiongen_client* client);
MOTIONGEN_C_API int32_t motiongen_client_is_connected(const motiongen_client* client);
/* 1 and the oldest event not taken, or 0 where there is none. */
MOTIONGEN_C_API int32_t motiongen_client_next_event(motiongen_client* client, motiongen_event* event);

/* ---- a clip: bounded motion, all samples in one call, which waits for them. Its handle outlives the client. */
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

/* ---- a session: one character. Destroying it closes it. */
MOTIONGEN_C_API motiongen_code motiongen_client_open(motiongen_client* client, const motiongen_session_options* options,
                                                     motiongen_session** session, motiongen_error* error);
MOTIONGEN_C_API void motiongen_session_destroy(motiongen_session* session);
MOTIONGEN_C_API uint32_t motiongen_session_id(const motiongen_session* session);
MOTIONGEN_C_API int32_t motiongen_session_is_open(const motiongen_session* session);
MOTIONGEN_C_API motiongen_code motiongen_session_wait_open(motiongen_session* session, double timeout_s,
                                                           motiongen_error* error);

/* What it is told. `edit`, where not NULL, gets the number that the answering event has. */
MOTIONGEN_C_API motiongen_code motiongen_session_set_prompt(motiongen_session* session, const char* text,
                                                            uint64_t* edit, motiongen_error* error);
/* From start_frame (0: as soon as possible) up to, not with, end_frame (0: until another takes over). id, where not
 * NULL, is for the next two. */
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
/* id, where not NULL, is for replace_target, remove_target and placement. */
MOTIONGEN_C_API motiongen_code motiongen_session_add_target(motiongen_session* session, const motiongen_target* target,
                                                            uint32_t* id, uint64_t* edit, motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_replace_target(motiongen_session* session, uint32_t id,
                                                                const motiongen_target* target, uint64_t* edit,
                                                                motiongen_error* error);
/* NOT_FOUND before the answer, and for a target whose frames and places were given. */
MOTIONGEN_C_API motiongen_code motiongen_session_placement(const motiongen_session* session, uint32_t target,
                                                           motiongen_placement* placement, motiongen_error* error);
/* Walk to a ground position, however far; relative: x_m to its left, z_m ahead of it. */
MOTIONGEN_C_API motiongen_code motiongen_session_go_to(motiongen_session* session, float x_m, float z_m,
                                                       const float* heading_rad, int32_t relative, uint32_t* id,
                                                       uint64_t* edit, motiongen_error* error);
/* Stand elsewhere from the first frame that can still change. */
MOTIONGEN_C_API motiongen_code motiongen_session_teleport(motiongen_session* session, float x_m, float z_m,
                                                          float heading_rad, uint64_t* edit, motiongen_error* error);
/* Go on from other frames, whole patches of them. */
MOTIONGEN_C_API motiongen_code motiongen_session_cut_to(motiongen_session* session, const float* rows,
                                                        uint32_t num_rows, uint64_t* edit, motiongen_error* error);
/* Go on from a frame of its own, as if the frames before that one had just been. */
MOTIONGEN_C_API motiongen_code motiongen_session_seek(motiongen_session* session, uint64_t frame, uint64_t* edit,
                                                      motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_set_options(motiongen_session* session,
                                                             const motiongen_options_change* change, uint64_t* edit,
                                                             motiongen_error* error);
/* heading_rad: NULL leaves it free. id, where not NULL, is for motiongen_session_remove_target. */
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

/* Its rig, once it is open: FAILED_PRECONDITION before. Names live as long as the session's handle; NULL for no joint.
 */
MOTIONGEN_C_API motiongen_code motiongen_session_rig(const motiongen_session* session, motiongen_rig* rig,
                                                     motiongen_error* error);
/* Where a block or an output of its rows begins, by its name, such as "joint_positions_m". */
MOTIONGEN_C_API motiongen_code motiongen_session_block(const motiongen_session* session, const char* name,
                                                       uint32_t* column, motiongen_error* error);
MOTIONGEN_C_API const char* motiongen_session_joint_name(const motiongen_session* session, uint32_t joint);
MOTIONGEN_C_API int32_t motiongen_session_joint_parent(const motiongen_session* session,
                                                       uint32_t joint); /* -1: the root */

/* Frames. row: row_floats numbers. 1 where there is a pose, between two frames, for now; else 0 and row is as it was.
 */
MOTIONGEN_C_API int32_t motiongen_session_sample(motiongen_session* session, float* row, uint32_t row_floats);
MOTIONGEN_C_API motiongen_code motiongen_session_copy_frame(const motiongen_session* session, uint64_t frame,
                                                            float* row, uint32_t row_floats, motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_wait_frame(motiongen_session* session, uint64_t frame,
                                                            double timeout_s, motiongen_error* error);
MOTIONGEN_C_API motiongen_code motiongen_session_advance_to(motiongen_session* session, uint64_t frame,
                                                            motiongen_error* error);
/* World positions of all joints of a row: positions_m has 3 floats a joint. */
MOTIONGEN_C_API motiongen_code motiongen_session_joint_positions(const motiongen_session* session, const float* row,
                                                                 float* positions_m, uint32_t num_floats,
                                                                 motiongen_error* error);
/* Play slower or faster than real time: 0.5 is half as fast. */
MOTIONGEN_C_API motiongen_code motiongen_session_set_time_scale(motiongen_session* session, double scale,
                                                                motiongen_error* error);
/* 1: its server saves it, so that another can go on with it. */
MOTIONGEN_C_API int32_t motiongen_session_is_durable(const motiongen_session* session);
MOTIONGEN_C_API uint64_t motiongen_session_playhead(const motiongen_session* session);
MOTIONGEN_C_API uint64_t motiongen_session_buffered_to(const motiongen_session* session);
MOTIONGEN_C_API uint32_t motiongen_session_underruns(const motiongen_session* session);

/* ---- ground: motion is made on a level floor at height 0; this puts it on slopes and steps before it is shown */

/* The ground's height in metres at world x, z. Asked some 60 times a frame, inside the calls below; it must not use the
 * session. */
typedef double (*motiongen_heights)(void* context, double x_m, double z_m);
typedef struct motiongen_ground motiongen_ground;
/* For one session that is open: FAILED_PRECONDITION before. Destroy it when nothing uses it any more. */
MOTIONGEN_C_API motiongen_code motiongen_ground_create(const motiongen_session* session, motiongen_heights heights,
                                                       void* context, motiongen_ground** ground,
                                                       motiongen_error* error);
MOTIONGEN_C_API void motiongen_ground_destroy(motiongen_ground* ground);
/* As motiongen_session_sample; where 0 is a mistake, `error` says so. */
MOTIONGEN_C_API int32_t motiongen_session_sample_on_ground(motiongen_session* session, motiongen_ground* ground,
                                                           float* row, uint32_t row_floats, motiongen_error* error);
/* All frames of a motion, as a clip has them, in place: num_rows rows of the session's rig. */
MOTIONGEN_C_API motiongen_code motiongen_ground_apply(motiongen_ground* ground, float* rows, uint32_t num_rows,
                                                      motiongen_error* error);

/* ---- help for engines, without a session */

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

#endif /* MOTIONGEN_MOTIONGEN_H_ */
