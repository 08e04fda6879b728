// Conversion of a server's catalogue from the contract's messages.
#include <algorithm>

#include "client/convert.hpp"

namespace motiongen::convert {
namespace {

// The limit on max_request_bytes, whatever the server says: requests are assembled in memory here first.
constexpr std::uint32_t kMostRequestBytes = std::uint32_t{1} << 26;

Result<Rig> rig(const v1::Rig& message) {
  Rig made;
  made.rig_id = message.rig_id();
  made.joint_names.assign(message.joints().begin(), message.joints().end());
  made.parents.assign(message.parents().begin(), message.parents().end());
  made.offsets_m.assign(message.neutral_offsets_m().begin(), message.neutral_offsets_m().end());
  made.frame_rate_hz = message.frame_rate();
  for (const auto& block : message.blocks()) made.blocks.push_back({block.name(), block.width()});
  made.hip_joints.assign(message.hip_joints().begin(), message.hip_joints().end());
  for (const auto& limb : message.limbs()) {
    made.limbs.push_back({limb.name(), {limb.joints().begin(), limb.joints().end()}});
  }
  Status checked = made.check();
  if (!checked) return checked;
  return made;
}

Model model(const v1::Model& message) {
  Model made;
  made.model_id = message.model_id();
  made.rig_id = message.rig_id();
  made.licence = message.licence();
  made.text_encoder = message.text_encoder();
  made.text_width = message.text_width();
  made.num_parameters = message.num_parameters();
  made.horizon_frames = message.horizon_frames();
  made.patch_frames = message.patch_frames();
  made.future_frames = message.future_frames();
  made.default_denoise_steps = message.default_denoise_steps();
  made.min_denoise_steps = message.min_denoise_steps();
  made.max_denoise_steps = message.max_denoise_steps();
  made.default_history_frames = message.default_history_frames();
  made.max_history_frames = message.max_history_frames();
  made.default_text_guidance = message.default_guidance().text();
  made.default_constraint_guidance = message.default_guidance().constraint();
  made.default_tolerance_m = message.default_tolerance_m();
  made.default_tolerance_rad = message.default_tolerance_rad();
  for (const auto& each : message.presets()) {
    made.presets.push_back({each.preset_id(), each.text(), each.description()});
  }
  for (const auto& each : message.constraint_forms()) {
    made.target_forms.push_back({each.form(), static_cast<FormSupport>(each.support())});
  }
  for (const auto& each : message.locomotion_presets()) {
    made.locomotion_presets.push_back(
        {each.name(), each.text(), each.from_speed_mps(), each.direction(), each.to_speed_mps()});
  }
  made.known_motions.assign(message.known_motions().begin(), message.known_motions().end());
  for (const auto& each : message.outputs()) made.outputs.push_back({each.name(), each.width()});
  return made;
}

Limits limits(const v1::Limits& message) {
  Limits made;
  made.max_sessions_per_stream = message.max_sessions_per_stream();
  made.max_constraints = message.max_constraints();
  made.max_prompts = message.max_prompts();
  made.max_prompt_characters = message.max_prompt_characters();
  made.max_events_per_second = message.max_events_per_second();
  made.max_stream_events_per_second = message.max_stream_events_per_second();
  made.max_lookahead_frames = message.max_lookahead_frames();
  made.default_lookahead_frames = message.default_lookahead_frames();
  made.max_trajectory_frames = message.max_trajectory_frames();
  made.max_held_trajectory_frames = message.max_held_trajectory_frames();
  made.max_request_bytes = std::min(message.max_request_bytes(), kMostRequestBytes);
  made.max_hold_frames = message.max_hold_frames();
  made.max_speed_mps = message.max_speed_mps();
  made.max_coordinate_m = message.max_coordinate_m();
  made.max_guidance = message.max_guidance();
  made.max_clip_frames = message.max_clip_frames();
  made.max_clip_samples = message.max_clip_samples();
  made.resume_grace_s = seconds(message.resume_grace());
  return made;
}

}  // namespace

Result<std::shared_ptr<const Catalog>> catalog(const v1::GetCatalogResponse& message) {
  auto made = std::make_shared<Catalog>();
  made->etag = message.catalog_etag();
  for (const auto& each : message.rigs()) {
    auto checked = rig(each);
    if (!checked) return checked.status();
    made->rigs.push_back(std::move(checked).value());
  }
  for (const auto& each : message.models()) made->models.push_back(model(each));
  if (made->models.empty()) return violation("the catalogue has no model");
  made->limits = limits(message.limits());
  if (message.has_free_share()) made->free_share = message.free_share();
  return std::shared_ptr<const Catalog>(std::move(made));
}

Result<Rig> session_rig(const Catalog& catalog, const v1::SessionOpened& message,
                        const std::vector<std::string>& outputs) {
  const auto found = std::find_if(catalog.rigs.begin(), catalog.rigs.end(),
                                  [&message](const Rig& each) { return each.rig_id == message.rig_id(); });
  if (found == catalog.rigs.end()) {
    return violation("a session was opened on rig " + message.rig_id() + ", which the catalogue does not have");
  }
  Rig rig = *found;
  std::vector<std::string> given;
  for (const auto& each : message.outputs()) {
    rig.outputs.push_back({each.name(), each.width()});
    given.push_back(each.name());
  }
  if (given != outputs) return violation("frames have other outputs than were asked for");
  Status checked = rig.check();
  if (!checked) return checked;
  return rig;
}

const Model* find_model(const Catalog& catalog, const std::string& model_id) {
  for (const Model& model : catalog.models) {
    if (model.model_id == model_id || model_id.empty()) return &model;
  }
  return nullptr;
}

const Rig* find_rig(const Catalog& catalog, const std::string& model_id) {
  const Model* model = find_model(catalog, model_id);
  for (const Rig& rig : catalog.rigs) {
    if (model != nullptr && rig.rig_id == model->rig_id) return &rig;
  }
  return nullptr;
}

}  // namespace motiongen::convert
