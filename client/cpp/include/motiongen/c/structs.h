/* Codes, handles and structs of the C interface. */
#ifndef MOTIONGEN_C_STRUCTS_H_
#define MOTIONGEN_C_STRUCTS_H_

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

/* The ABI version of the loaded library. As long as it is the same, functions are added but never changed. */
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
  char message[512]; /* for people; truncated to fit */
} motiongen_error;

typedef struct motiongen_client_options {
  uint32_t struct_size;
  uint32_t use_tls;    /* 1: TLS with root_certificates_pem, or the system's where that is NULL */
  const char* address; /* host:port, or unix:PATH for a socket of this machine */
  const char* token;   /* NULL: none; else printable ASCII without spaces. Without TLS it may only go to this machine */
  const char* root_certificates_pem;
  double connect_timeout_s; /* 0: 10 s */
  uint32_t no_reconnect;    /* 1: sessions end when the stream is lost */
  uint32_t num_other_addresses;
  const char* const* other_addresses; /* servers that share a store of sessions, tried in turn */
  const char* certificate_chain_pem;  /* the client's, if the server requires one; with private_key_pem */
  const char* private_key_pem;
  /* In place of token; NULL: none. Called before every call to the server, so that an expiring token can be renewed. It
   * writes the token with its NUL, at most `size` bytes, and returns 1, or returns 0 if there is no token at present;
   * it is then called again later. It is called on threads of the library, one call at a time, should return quickly,
   * must not use the client and must remain callable as long as the client exists. */
  int32_t (*token_source)(void* context, char* token, uint32_t size);
  void* token_context; /* its first argument */
} motiongen_client_options;

/* How frames are encoded on the wire. */
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
  uint32_t keep_prompts;   /* 1: prompts stay in force even where targets ask for a pace that contradicts them */
  const char* preset_id;   /* a preset of the catalogue, in place of `prompt` */
  const float* prior_rows; /* the motion just before frame 0: num_prior_rows rows of the rig */
  uint32_t num_prior_rows;
  uint32_t prior_row_floats; /* floats in each of them: the rig's, without outputs */
  float text_guidance;       /* read only with has_text_guidance; the same goes for target_guidance */
  float target_guidance;
  uint32_t has_text_guidance;
  uint32_t has_target_guidance;
  const char* const* outputs; /* further blocks of each row; motiongen_session_block gives their columns */
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
  MOTIONGEN_EVENT_REACHED = 9,    /* a target was met or missed; its last frame can no longer change */
  MOTIONGEN_EVENT_DURABILITY = 10 /* whether another server could continue the session has changed */
};

typedef struct motiongen_event {
  uint32_t struct_size;
  uint32_t kind;
  uint32_t session;    /* motiongen_session_id; 0: the event concerns the connection */
  motiongen_code code; /* of the answer to an edit, of a close or of a lost connection */
  uint64_t edit;
  uint64_t frame; /* EDIT: the first frame it affects; RECOVERED: the first frame of new motion */
  uint32_t has_frame;
  uint32_t exact; /* RECOVERED: 1 if the motion is the same as without the loss */
  uint32_t tier;  /* SERVICE_LEVEL: 1 full, 2 fewer steps, 3 no guidance, 5 holds its pose */
  uint32_t denoise_steps;
  char reason[64];
  char message[512];
  uint32_t target; /* REACHED: the target's id; the next five and `frame` describe that target */
  uint32_t met;    /* 1: within its tolerances */
  uint32_t has_position_error;
  float position_error_m;
  uint32_t has_rotation_error;
  float rotation_error_rad;
  uint32_t is_durable; /* DURABILITY */
  uint32_t reserved;
} motiongen_event;

/* A text, a preset's id, or a text encoder's vector. With a vector, `text` is only a description for people. */
typedef struct motiongen_prompt {
  uint32_t struct_size;
  uint32_t num_embedding;
  const char* text;
  const char* preset_id;
  const char* text_encoder;
  const float* embedding;
} motiongen_prompt;

enum {
  MOTIONGEN_TARGET_WAYPOINT = 1,        /* x_m, z_m; optionally heading_rad */
  MOTIONGEN_TARGET_ROOT_TRAJECTORY = 2, /* positions_m: x z of consecutive frames; optionally headings_rad */
  MOTIONGEN_TARGET_KEYFRAME = 3,        /* positions_m: x y z of every joint */
  MOTIONGEN_TARGET_JOINTS = 4,          /* joints, positions_m: x y z of each; optionally rotations_wxyz */
  MOTIONGEN_TARGET_HEADING = 5,         /* heading_rad */
  MOTIONGEN_TARGET_JOINT_ROTATIONS = 6, /* joints, rotations_wxyz */
  MOTIONGEN_TARGET_ROOT_PATH = 7,       /* positions_m: x z of each corner; optionally speed_mps, smoothing_m */
  MOTIONGEN_TARGET_FOOT_CONTACT = 8     /* limb, x_m, z_m; optionally heading_rad */
};

/* Where a character should be and when; client/targets.hpp describes each form. */
typedef struct motiongen_target {
  uint32_t struct_size;
  uint32_t form;
  uint64_t frame; /* 0 for a path or with at_any_frame */
  uint64_t last_frame;
  uint32_t has_last_frame;        /* 1: it may be met at any frame up to last_frame */
  uint32_t at_any_frame;          /* 1: as soon as a person can get there */
  uint32_t frames_from_effect;    /* 1: frames count from the one at which the edit takes effect */
  uint32_t relative_to_character; /* 1: places and angles are relative to the character then: x to its left, z ahead */
  float weight;                   /* above 0, at most 10; 0: 1, it must be met */
  float x_m;
  float z_m;
  float heading_rad;
  uint32_t has_heading;
  uint32_t num_positions; /* of 2 or 3 floats each */
  const float* positions_m;
  const float* headings_rad; /* one for each position; NULL leaves them free */
  const uint32_t* joints;
  const float* rotations_wxyz; /* one for each joint; NULL leaves them free */
  uint32_t num_joints;
  float tolerance_m; /* read only with has_tolerance_m, tolerance_rad with has_tolerance_rad; else the model's */
  float tolerance_rad;
  uint32_t has_tolerance_m;
  uint32_t has_tolerance_rad;
  float speed_mps; /* 0: 1.2 */
  float smoothing_m;
  uint32_t has_smoothing; /* 0: smoothing is 0.3 m */
  const char* limb;       /* LeftFoot or RightFoot */
} motiongen_target;

/* Where the server put a target that left frames or places to it. */
typedef struct motiongen_placement {
  uint32_t struct_size;
  uint32_t target;
  uint64_t first_frame;
  uint64_t last_frame;
  uint64_t arrival_frame; /* the frame that the server aims for */
  uint64_t anchor_frame;  /* the frame at which it takes effect; below: the character just before it */
  float anchor_x_m;
  float anchor_z_m;
  float anchor_heading_rad;
  uint32_t reserved;
} motiongen_placement;

/* What to change in an open session; 0 leaves a field unchanged. */
typedef struct motiongen_options_change {
  uint32_t struct_size;
  uint32_t priority;
  uint32_t lookahead_frames;
  uint32_t denoise_steps;
  uint32_t history_frames;
  uint32_t has_guidance; /* 1: sets both weights; one without its has_ flag returns to the model's default */
  float text_guidance;
  float target_guidance;
  uint32_t has_text_guidance;
  uint32_t has_target_guidance;
} motiongen_options_change;

/* An array element, so the struct never grows. */
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
  const motiongen_target* const* targets; /* their residuals come after those of the waypoints */
} motiongen_clip_options;

/* How near the motion came to one target, measured by itself: the greatest errors. */
typedef struct motiongen_residual {
  uint32_t struct_size;
  uint32_t num_frames; /* of the target, within the clip; 0: nothing was measured */
  uint32_t met;
  uint32_t has_position;
  float position_m;
  uint32_t has_heading;
  float heading_rad;
  uint32_t has_rotation;
  float rotation_rad;
} motiongen_residual;

typedef struct motiongen_clip motiongen_clip;

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* MOTIONGEN_C_STRUCTS_H_ */
