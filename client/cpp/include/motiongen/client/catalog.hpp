// What a server offers: rigs, models, and what a client must keep to.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "motiongen/core/rig.hpp"

namespace motiongen {

// A prompt that the server knows beforehand.
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

// The prompt that holds while a velocity of some speed and direction leads.
struct LocomotionPreset {
  std::string name;
  std::string text;
  float from_speed_mps = 0;
  std::string direction;   // forward, backward, left or right of the heading
  float to_speed_mps = 0;  // feet may glide at more, which is warned of; 0: nothing is claimed
};

struct Model {
  std::string model_id;
  std::string rig_id;
  std::string licence;
  std::string text_encoder;
  std::uint32_t text_width = 0;  // numbers of a Prompt::embedding
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
  std::vector<TargetFormSupport> target_forms;  // empty: nothing is claimed, and all are taken
  std::vector<LocomotionPreset> locomotion_presets;
  std::vector<std::string> known_motions;
  std::vector<Block> outputs;  // what a frame may have besides
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
  std::uint32_t max_held_trajectory_frames = 0;  // of all that a session holds; 0: the server tells of no limit
  std::uint32_t max_request_bytes = 0;
  std::uint32_t max_hold_frames = 0;
  float max_speed_mps = 0;
  float max_coordinate_m = 0;
  float max_guidance = 0;
  std::uint32_t max_clip_frames = 0;
  std::uint32_t max_clip_samples = 0;
  double resume_grace_s = 0;  // for how long a session is kept whose stream was lost
};

// models[0] is the server's default.
struct Catalog {
  std::string etag;
  std::vector<Rig> rigs;
  std::vector<Model> models;
  Limits limits;
  std::optional<float> free_share;  // of what the server can carry, what it had left to new sessions; absent: not said
};

}  // namespace motiongen
