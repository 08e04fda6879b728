// Clips: one call each, its parts sorted by sample.
#include <cmath>
#include <cstring>

#include "client/convert.hpp"
#include "client/core.hpp"
#include "client/status_details.hpp"
#include "motiongen/v1/service.grpc.pb.h"

namespace motiongen {
namespace {

Status check(const ClipOptions& options, const Limits& limits) {
  const auto in_range = [](const char* field, std::uint32_t given, std::uint32_t most) {
    if (given >= 1 && given <= most) return Status();
    return invalid(field, std::to_string(given), "1 to " + std::to_string(most));
  };
  Status checked = in_range("num_frames", options.num_frames, limits.max_clip_frames);
  if (checked) checked = in_range("num_samples", options.num_samples, limits.max_clip_samples);
  if (!std::isfinite(options.timeout_s) || !(options.timeout_s > 0)) {
    checked = invalid("timeout_s", std::to_string(options.timeout_s), "a number above 0");
  }
  for (const Target& target : options.targets) {
    if (checked) checked = convert::check(target);
  }
  return checked;
}

v1::GenerateClipRequest request_of(const ClipOptions& options) {
  SessionOptions session;
  session.model_id = options.model_id;
  session.seed = options.seed;
  session.denoise_steps = options.denoise_steps;
  session.history_frames = options.history_frames;
  session.text_guidance = options.text_guidance;
  session.constraint_guidance = options.constraint_guidance;
  session.start_x_m = options.start_x_m;
  session.start_z_m = options.start_z_m;
  session.start_heading_rad = options.start_heading_rad;
  v1::GenerateClipRequest request;
  v1::OpenSession& open = *request.mutable_open();
  open = convert::open_session(session);
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

// One sample as it comes.
struct Sample {
  Clip clip;
  std::size_t row_width = 0;
  bool is_whole = false;

  Status take(const v1::GenerateClipResponse& part, const Catalog& catalog) {
    if (part.has_opened()) return take_opened(part.opened(), catalog);
    if (part.has_chunk()) return take_chunk(part.chunk());
    if (!part.has_summary()) return {};
    for (const auto& each : part.summary().residuals()) clip.residuals.push_back(convert::residual(each));
    is_whole = true;
    return {};
  }

  Status take_opened(const v1::SessionOpened& message, const Catalog& catalog) {
    clip.opened = convert::opened(message);
    for (const Rig& rig : catalog.rigs) {
      if (rig.rig_id == clip.opened.rig_id) row_width = rig.row_width;
    }
    return row_width > 0 ? Status() : violation("a clip is of rig " + clip.opened.rig_id + ", which nobody knows");
  }

  Status take_chunk(const v1::FrameChunk& chunk) {
    if (chunk.first_frame() != clip.num_frames) {
      return violation("frame " + std::to_string(chunk.first_frame()) + " of a clip came after " +
                       std::to_string(clip.num_frames) + " frames");
    }
    const std::string& data = chunk.data();
    if (chunk.scalar_type() != v1::SCALAR_TYPE_F32_LE || row_width == 0 ||
        data.size() != chunk.frame_count() * row_width * sizeof(float)) {
      return violation("a chunk of a clip has " + std::to_string(data.size()) + " bytes for " +
                       std::to_string(chunk.frame_count()) + " rows of " + std::to_string(row_width) + " floats");
    }
    const std::size_t held = clip.rows.size();
    clip.rows.resize(held + data.size() / sizeof(float));
    std::memcpy(clip.rows.data() + held, data.data(), data.size());
    clip.num_frames += chunk.frame_count();
    return {};
  }
};

}  // namespace

Result<std::vector<Clip>> ClientCore::generate_clip(const ClipOptions& options) {
  if (events_.in_callback()) {
    return Status(Code::failed_precondition, "IN_CALLBACK", "a clip cannot be waited for inside an event callback");
  }
  const auto known = catalog();
  Status checked = check(options, known->limits);
  if (!checked) return checked;
  ShortCall call(*this, options.timeout_s);
  const auto stub = v1::MotionService::NewStub(server().channel);
  const auto reader = stub->GenerateClip(&call.context, request_of(options));
  std::vector<Sample> samples(options.num_samples);
  v1::GenerateClipResponse part;
  Status broken;
  while (broken && reader->Read(&part)) {
    broken = part.sample() < samples.size()
                 ? samples[part.sample()].take(part, *known)
                 : violation("sample " + std::to_string(part.sample()) + " was not asked for");
  }
  if (!broken) call.context.TryCancel();
  const grpc::Status status = reader->Finish();
  if (!broken) return broken;
  if (!status.ok()) return status_of(status);
  std::vector<Clip> clips;
  for (Sample& each : samples) {
    if (!each.is_whole || each.clip.num_frames != options.num_frames ||
        each.clip.residuals.size() != options.targets.size()) {
      return violation("a clip of " + std::to_string(options.num_frames) + " frames and " +
                       std::to_string(options.targets.size()) + " targets ended after " +
                       std::to_string(each.clip.num_frames) + " frames and " +
                       std::to_string(each.clip.residuals.size()) + " residuals");
    }
    clips.push_back(std::move(each.clip));
  }
  return clips;
}

}  // namespace motiongen
