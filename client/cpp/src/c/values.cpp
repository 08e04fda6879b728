#include "c/values.hpp"

#include <utility>

#include "c/structs.hpp"

namespace motiongen::c {
namespace {

Status no_pointer(const char* what) {
  return invalid(what, "NULL or a struct_size of 0", "a pointer to what the header says");
}

std::vector<float> numbers(const float* from, std::size_t count) {
  return from == nullptr ? std::vector<float>() : std::vector<float>(from, from + count);
}

// A form without its tolerance.
Result<TargetForm> form_of(const motiongen_target& given) {
  const std::size_t count = given.num_positions;
  const std::vector<std::uint32_t> joints =
      given.joints == nullptr ? std::vector<std::uint32_t>()
                              : std::vector<std::uint32_t>(given.joints, given.joints + given.num_joints);
  const std::vector<float> rotations = numbers(given.rotations_wxyz, 4 * joints.size());
  switch (given.form) {
    case MOTIONGEN_TARGET_WAYPOINT: {
      Waypoint waypoint{given.frame, given.x_m, given.z_m, {}, {}};
      if (given.has_heading != 0) waypoint.heading_rad = given.heading_rad;
      return TargetForm(waypoint);
    }
    case MOTIONGEN_TARGET_ROOT_TRAJECTORY:
      return TargetForm(
          RootTrajectory{given.frame, numbers(given.positions_m, 2 * count), numbers(given.headings_rad, count), {}});
    case MOTIONGEN_TARGET_KEYFRAME:
      return TargetForm(Keyframe{given.frame, numbers(given.positions_m, 3 * count), {}});
    case MOTIONGEN_TARGET_JOINTS:
      return TargetForm(JointTargets{given.frame, joints, numbers(given.positions_m, 3 * count), rotations, {}});
    case MOTIONGEN_TARGET_HEADING:
      return TargetForm(HeadingTarget{given.frame, given.heading_rad, {}});
    case MOTIONGEN_TARGET_JOINT_ROTATIONS:
      return TargetForm(JointRotations{given.frame, joints, rotations, {}});
    case MOTIONGEN_TARGET_ROOT_PATH: {
      RootPath path{numbers(given.positions_m, 2 * count), {}, {}, {}};
      if (given.speed_mps != 0) path.speed_mps = given.speed_mps;
      if (given.has_smoothing != 0) path.smoothing_m = given.smoothing_m;
      return TargetForm(std::move(path));
    }
    case MOTIONGEN_TARGET_FOOT_CONTACT: {
      FootContact foot{given.frame, text(given.limb), given.x_m, given.z_m, {}, {}};
      if (given.has_heading != 0) foot.heading_rad = given.heading_rad;
      return TargetForm(std::move(foot));
    }
    default:
      return invalid("form", std::to_string(given.form),
                     "one of MOTIONGEN_TARGET_WAYPOINT to MOTIONGEN_TARGET_FOOT_CONTACT");
  }
}

}  // namespace

Result<Target> target_of(const motiongen_target* from) {
  motiongen_target given;
  if (!read(from, given)) return no_pointer("target");
  auto form = form_of(given);
  if (!form) return form.status();
  Tolerance tolerance;
  if (given.has_tolerance_m != 0) tolerance.position_m = given.tolerance_m;
  if (given.has_tolerance_rad != 0) tolerance.rotation_rad = given.tolerance_rad;
  std::visit([&tolerance](auto& each) { each.tolerance = tolerance; }, form.value());
  Target target = std::move(form).value();
  if (given.has_last_frame != 0) target.last_frame = given.last_frame;
  target.at_any_frame = given.at_any_frame != 0;
  target.frames_from_effect = given.frames_from_effect != 0;
  target.relative_to_character = given.relative_to_character != 0;
  if (given.weight != 0) target.weight = given.weight;
  return target;
}

Result<Prompt> prompt_of(const motiongen_prompt* from) {
  motiongen_prompt given;
  if (!read(from, given)) return no_pointer("prompt");
  if (given.num_embedding > 0 && given.embedding == nullptr) return no_pointer("embedding");
  Prompt prompt(text(given.text));
  prompt.preset_id = text(given.preset_id);
  prompt.text_encoder = text(given.text_encoder);
  prompt.embedding = numbers(given.embedding, given.num_embedding);
  return prompt;
}

Result<OptionsChange> change_of(const motiongen_options_change* from) {
  motiongen_options_change given;
  if (!read(from, given)) return no_pointer("change");
  if (given.priority > 4) return invalid("priority", std::to_string(given.priority), "1 to 4, or 0 to leave it");
  OptionsChange change;
  if (given.priority != 0) change.priority = static_cast<Priority>(given.priority);
  if (given.lookahead_frames != 0) change.lookahead_frames = given.lookahead_frames;
  if (given.denoise_steps != 0) change.denoise_steps = given.denoise_steps;
  if (given.history_frames != 0) change.history_frames = given.history_frames;
  if (given.has_guidance != 0) {
    change.guidance.emplace();
    if (given.has_text_guidance != 0) change.guidance->first = given.text_guidance;
    if (given.has_target_guidance != 0) change.guidance->second = given.target_guidance;
  }
  return change;
}

}  // namespace motiongen::c
