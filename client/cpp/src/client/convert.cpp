#include "client/convert.hpp"

#include <cmath>
#include <string>

namespace motiongen::convert {
namespace {

Code code_of(int number) {
  return number >= 0 && number <= static_cast<int>(Code::unauthenticated) ? static_cast<Code>(number) : Code::unknown;
}

template <class Messages>
std::vector<Warning> warnings(const Messages& messages) {
  std::vector<Warning> found;
  for (const auto& each : messages) found.push_back({each.reason(), each.message(), each.field()});
  return found;
}

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
  made.horizon_frames = message.horizon_frames();
  made.patch_frames = message.patch_frames();
  made.default_denoise_steps = message.default_denoise_steps();
  made.min_denoise_steps = message.min_denoise_steps();
  made.max_denoise_steps = message.max_denoise_steps();
  made.max_history_frames = message.max_history_frames();
  for (const auto& preset : message.presets()) made.preset_ids.push_back(preset.preset_id());
  return made;
}

}  // namespace

v1::PromptSpan span(std::uint32_t id, const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame) {
  v1::PromptSpan message;
  message.set_prompt_id(id);
  message.set_start_frame(start_frame);
  message.set_end_frame(end_frame);
  message.set_text(prompt.text);
  message.set_preset_id(prompt.preset_id);
  if (!prompt.embedding.empty()) {
    auto* embedding = message.mutable_embedding();
    embedding->set_text_encoder(prompt.text_encoder);
    embedding->mutable_values()->Add(prompt.embedding.begin(), prompt.embedding.end());
  }
  return message;
}

v1::OpenSession open_session(const SessionOptions& options) {
  v1::OpenSession message;
  message.set_model_id(options.model_id);
  if (options.seed) message.set_seed(*options.seed);
  message.set_priority(static_cast<v1::PriorityClass>(options.priority));
  message.set_lookahead_frames(options.lookahead_frames);
  message.set_scalar_type(v1::SCALAR_TYPE_F32_LE);
  if (options.denoise_steps != 0) message.set_denoise_steps(options.denoise_steps);
  if (options.history_frames != 0) message.set_history_frames(options.history_frames);
  if (options.text_guidance) message.mutable_guidance()->set_text(*options.text_guidance);
  if (options.constraint_guidance) message.mutable_guidance()->set_constraint(*options.constraint_guidance);
  if (options.start_x_m != 0 || options.start_z_m != 0 || options.start_heading_rad) {
    auto* pose = message.mutable_start_pose();
    pose->set_x(options.start_x_m);
    pose->set_z(options.start_z_m);
    if (options.start_heading_rad) pose->set_heading(*options.start_heading_rad);
  }
  return message;
}

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
  const auto& limits = message.limits();
  made->limits.max_sessions_per_stream = limits.max_sessions_per_stream();
  made->limits.max_lookahead_frames = limits.max_lookahead_frames();
  made->limits.default_lookahead_frames = limits.default_lookahead_frames();
  made->limits.max_trajectory_frames = limits.max_trajectory_frames();
  made->limits.max_request_bytes = limits.max_request_bytes();
  made->limits.max_hold_frames = limits.max_hold_frames();
  made->limits.max_speed_mps = limits.max_speed_mps();
  made->limits.max_clip_frames = limits.max_clip_frames();
  made->limits.max_clip_samples = limits.max_clip_samples();
  return std::shared_ptr<const Catalog>(std::move(made));
}

Opened opened(const v1::SessionOpened& message) {
  Opened made;
  made.session_id = message.session_id();
  made.model_id = message.model_id();
  made.rig_id = message.rig_id();
  made.seed = message.seed();
  made.lookahead_frames = message.lookahead_frames();
  made.committed_horizon_frames = message.committed_horizon_frames();
  made.denoise_steps = message.denoise_steps();
  made.warnings = warnings(message.warnings());
  return made;
}

Outcome outcome(const v1::EditOutcome& message) {
  Outcome made;
  if (message.code() != 0) made.status = Status(code_of(message.code()), message.reason(), message.message());
  if (message.has_effective_frame()) made.effective_frame = message.effective_frame();
  made.field = message.field();
  made.allowed = message.allowed();
  if (message.has_retry_after()) made.retry_after_s = seconds(message.retry_after());
  made.warnings = warnings(message.warnings());
  return made;
}

Reached reached(const v1::ConstraintReached& message) {
  Reached made;
  made.target = message.constraint_id();
  made.met = message.met();
  made.frame = message.frame();
  if (message.has_position_error_m()) made.position_error_m = message.position_error_m();
  if (message.has_rotation_error_rad()) made.rotation_error_rad = message.rotation_error_rad();
  return made;
}

Residual residual(const v1::ConstraintResidual& message) {
  const auto deviation = [](const v1::Deviation& each) { return Deviation{each.mean(), each.worst()}; };
  Residual made;
  made.num_frames = message.frame_count();
  if (message.has_position_m()) made.position_m = deviation(message.position_m());
  if (message.has_heading_rad()) made.heading_rad = deviation(message.heading_rad());
  if (message.has_rotation_rad()) made.rotation_rad = deviation(message.rotation_rad());
  made.met = message.met();
  return made;
}

Status closed(const v1::SessionClosed& message) {
  std::string reason = v1::CloseReason_Name(message.reason());
  const std::string prefix = "CLOSE_REASON_";
  reason = reason.empty() ? "UNSPECIFIED" : reason.substr(prefix.size());
  const Code code = message.code() == 0 ? Code::aborted : code_of(message.code());
  return {code, reason, message.message().empty() ? "the server ended the session" : message.message()};
}

double seconds(const google::protobuf::Duration& duration) {
  return static_cast<double>(duration.seconds()) + duration.nanos() / 1e9;
}

void set_seconds(double seconds, google::protobuf::Duration* duration) {
  const double whole = std::floor(seconds);
  duration->set_seconds(static_cast<std::int64_t>(whole));
  duration->set_nanos(static_cast<std::int32_t>((seconds - whole) * 1e9));
}

}  // namespace motiongen::convert
