// Clips: bounded motion in one call, several samples at once, as fast as the server generates it.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "motiongen/client/types.hpp"

namespace motiongen {

// What to make a clip of; the server chooses what is empty, absent or 0.
struct ClipOptions {
  std::uint32_t num_frames = 0;   // from 1 to Limits::max_clip_frames
  std::uint32_t num_samples = 1;  // up to Limits::max_clip_samples; sample n has seed + n
  std::string model_id;
  Prompt prompt;
  std::vector<std::pair<std::uint64_t, Prompt>> later_prompts;  // each with the frame from which it is in force
  std::vector<Target> targets;
  std::optional<std::uint64_t> seed;
  std::uint32_t denoise_steps = 0;
  std::uint32_t history_frames = 0;
  std::optional<float> text_guidance;
  std::optional<float> constraint_guidance;
  float start_x_m = 0;
  float start_z_m = 0;
  std::optional<float> start_heading_rad;
  bool keep_prompts = false;
  FrameFormat frame_format = FrameFormat::f32;
  std::vector<std::string> outputs;  // of Model::outputs
  double timeout_s = 60;
};

struct Deviation {
  float mean = 0;
  float worst = 0;
};

// How far the motion is from one target, measured by itself. Absent: the target does not ask for it.
struct Residual {
  std::uint32_t num_frames = 0;  // of the target, within the clip; 0: nothing was measured
  std::optional<Deviation> position_m;
  std::optional<Deviation> heading_rad;
  std::optional<Deviation> rotation_rad;
  bool met = false;
};

// One sample. rows: num_frames rows of rig.row_width floats, one after another. residuals: one for each target, in
// order.
struct Clip {
  Opened opened;
  Rig rig;
  std::uint32_t num_frames = 0;
  std::vector<float> rows;
  std::vector<Residual> residuals;
};

}  // namespace motiongen
