// Clips: one call each, whose parts are sorted by sample.
#include "client/clip_sample.hpp"
#include "client/convert.hpp"
#include "client/core.hpp"
#include "client/status_details.hpp"
#include "motiongen/v1/service.grpc.pb.h"

namespace motiongen {
namespace {

// The options of a session that makes the same motion.
SessionOptions session_of(const ClipOptions& options) {
  SessionOptions session;
  session.model_id = options.model_id;
  session.prompt = options.prompt;
  session.later_prompts = options.later_prompts;
  session.targets = options.targets;
  session.seed = options.seed;
  session.denoise_steps = options.denoise_steps;
  session.history_frames = options.history_frames;
  session.text_guidance = options.text_guidance;
  session.constraint_guidance = options.constraint_guidance;
  session.start_x_m = options.start_x_m;
  session.start_z_m = options.start_z_m;
  session.start_heading_rad = options.start_heading_rad;
  session.keep_prompts = options.keep_prompts;
  session.frame_format = options.frame_format;
  session.outputs = options.outputs;
  return session;
}

Status check(const ClipOptions& options, const Limits& limits) {
  const auto in_range = [](const char* field, std::uint32_t given, std::uint32_t most) {
    if (given >= 1 && given <= most) return Status();
    return invalid(field, std::to_string(given), "1 to " + std::to_string(most));
  };
  Status checked = in_range("num_frames", options.num_frames, limits.max_clip_frames);
  if (checked) checked = in_range("num_samples", options.num_samples, limits.max_clip_samples);
  if (!(options.timeout_s > 0)) {
    checked = invalid("timeout_s", std::to_string(options.timeout_s), "a number above 0");
  }
  return checked ? convert::check(session_of(options)) : checked;
}

v1::GenerateClipRequest request_of(const ClipOptions& options) {
  v1::GenerateClipRequest request;
  v1::OpenSession& open = *request.mutable_open();
  open = convert::open_session(session_of(options));
  open.clear_priority();
  std::uint32_t id = 1;
  if (!options.prompt.empty()) *open.add_prompts() = convert::span(id++, options.prompt, 0, 0);
  for (const auto& [frame, prompt] : options.later_prompts) *open.add_prompts() = convert::span(id++, prompt, frame, 0);
  id = 1;
  for (const Target& target : options.targets) *open.add_constraints() = convert::constraint(id++, target);
  request.set_frame_count(options.num_frames);
  request.set_sample_count(options.num_samples);
  return request;
}

}  // namespace

Result<std::vector<Clip>> ClientCore::generate_clip(const ClipOptions& options) {
  if (events_.in_callback()) {
    return Status(Code::failed_precondition, "IN_CALLBACK", "a clip cannot be waited for inside an event callback");
  }
  auto known = catalog();
  Status checked = check(options, known->limits);
  if (!checked) return checked;
  ShortCall call(*this, options.timeout_s);
  if (!call.made) return call.made;
  const auto stub = v1::MotionService::NewStub(server().channel);
  const auto reader = stub->GenerateClip(&call.context, request_of(options));
  std::vector<ClipSample> samples(options.num_samples);
  v1::GenerateClipResponse part;
  Status broken;
  while (broken && reader->Read(&part)) {
    if (part.has_opened() && !knows_rig_of(part.opened())) {  // a model loaded since the catalogue was fetched
      static_cast<void>(fetch_catalog(ask_timeout_s_));
      known = catalog();
    }
    broken = part.sample() < samples.size()
                 ? samples[part.sample()].take(part, *known, options)
                 : violation("sample " + std::to_string(part.sample()) + " was not asked for");
  }
  if (!broken) call.context.TryCancel();
  const grpc::Status status = reader->Finish();
  if (!broken) return broken;
  if (!status.ok()) return status_of(status);
  std::vector<Clip> clips;
  for (ClipSample& each : samples) {
    if (!each.is_whole || each.clip.num_frames != options.num_frames) {
      return violation("a clip of " + std::to_string(options.num_frames) + " frames ended after " +
                       std::to_string(each.clip.num_frames) + (each.is_whole ? "" : ", without a summary"));
    }
    clips.push_back(std::move(each.clip));
  }
  return clips;
}

}  // namespace motiongen
