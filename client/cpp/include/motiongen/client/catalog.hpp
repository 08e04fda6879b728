// What a server offers (rigs and models), and the limits that a client must respect.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "motiongen/core/rig.hpp"

namespace motiongen {

// A prompt that the server knows beforehand, named by its id.
struct Preset {
  std::string preset_id;
  std::string text;
  std::string description;
};

// Whether a model was trained for a form of target: "waypoint", "hands", ...
enum class FormSupport { trained = 1, untrained = 2, refused = 3 };

struct TargetFormSupport {
  std::string form;
  FormSupport support = FormSupport::trained;
};

// The prompt that is in force while a velocity of a certain speed and direction steers the character.
struct LocomotionPreset {
  std::string name;
  std::string text;
  float from_speed_mps = 0;
  std::string direction;   // forward, backward, left or right of the heading
  float to_speed_mps = 0;  // above it feet may slide, and the server warns; 0: unknown
};

struct Model {
  std::string model_id;
  std::string rig_id;
  std::string licence;
  std::string text_encoder;
  std::uint32_t text_width = 0;  // length of Prompt::embedding
  std::uint64_t num_parameters = 0;
  std::uint32_t horizon_frames = 0;
  std::uint32_t patch_frames = 0;
  std::uint32_t future_frames = 0;
  std::uint32_t default_denoise_steps = 0;
  std::uint32_t min_denoise_steps = 0;
  std::uint32_t max_denoise_steps = 0;
  std::uint32_t default_history_frames = 0;
  std::uint32_t max_history_frames = 0;
  float default_text_guidance = 0;
  float default_constraint_guidance = 0;
  float default_tolerance_m = 0;
  float default_tolerance_rad = 0;
  std::vector<Preset> presets;
  std::vector<TargetFormSupport> target_forms;  // empty: not stated, and all are accepted
  std::vector<LocomotionPreset> locomotion_presets;
  std::vector<std::string> known_motions;
  std::vector<Block> outputs;  // further blocks that a frame row may have
};

struct Limits {
  std::uint32_t max_sessions_per_stream = 0;
  std::uint32_t max_constraints = 0;
  std::uint32_t max_prompts = 0;
  std::uint32_t max_prompt_characters = 0;
  float max_events_per_second = 0;
  float max_stream_events_per_second = 0;
  std::uint32_t max_lookahead_frames = 0;
  std::uint32_t default_lookahead_frames = 0;
  std::uint32_t max_trajectory_frames = 0;
  std::uint32_t max_held_trajectory_frames = 0;  // over all trajectories of a session; 0: the server states no limit
  std::uint32_t max_request_bytes = 0;
  std::uint32_t max_hold_frames = 0;
  float max_speed_mps = 0;
  float max_coordinate_m = 0;
  float max_guidance = 0;
  std::uint32_t max_clip_frames = 0;
  std::uint32_t max_clip_samples = 0;
  double resume_grace_s = 0;  // how long the server keeps a session whose stream was lost
};

// models[0] is the server's default.
struct Catalog {
  std::string etag;
  std::vector<Rig> rigs;
  std::vector<Model> models;
  Limits limits;
  std::optional<float> free_share;  // of the server's capacity, the share free for new sessions; absent: unknown
};

}  // namespace motiongen
