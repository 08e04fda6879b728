// Clips: one call each, its parts sorted by sample.
#include <cmath>
#include <cstring>

#include "client/convert.hpp"
#include "client/core.hpp"
#include "client/status_details.hpp"
#include "motiongen/v1/service.grpc.pb.h"

namespace motiongen {
namespace {

// What a session would be opened with for it.
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

// The bytes of a chunk that is a message.
class ChunkBytes final : public RowSource {
 public:
  explicit ChunkBytes(const std::string& data) : data_(data) {}
  std::size_t num_bytes() const override { return data_.size() - taken_; }
  void take(std::size_t count, void* to) override {
    if (to != nullptr) std::memcpy(to, data_.data() + taken_, count);
    taken_ += count;
  }

 private:
  const std::string& data_;
  std::size_t taken_ = 0;
};

// One sample as it comes.
struct Sample {
  Clip clip;
  std::optional<FrameDecoder> decoder;
  bool is_whole = false;

  Status take(const v1::GenerateClipResponse& part, const Catalog& catalog, const ClipOptions& options) {
    if (part.has_opened()) return take_opened(part.opened(), catalog, options);
    if (part.has_chunk()) return take_chunk(part.chunk(), options);
    if (!part.has_summary()) return {};
    for (const auto& each : part.summary().residuals()) clip.residuals.push_back(convert::residual(each));
    is_whole = true;
    return {};
  }

  Status take_opened(const v1::SessionOpened& message, const Catalog& catalog, const ClipOptions& options) {
    auto rig = convert::session_rig(catalog, message, options.outputs);
    if (!rig) return rig.status();
    clip.opened = convert::opened(message);
    clip.rig = std::move(rig).value();
    decoder.emplace(clip.rig, options.frame_format);
    return {};
  }

  Status take_chunk(const v1::FrameChunk& chunk, const ClipOptions& options) {
    if (!decoder) return violation("a chunk of a clip came before it was opened");
    if (chunk.first_frame() != clip.num_frames) {
      return violation("frame " + std::to_string(chunk.first_frame()) + " of a clip came after " +
                       std::to_string(clip.num_frames) + " frames");
    }
    if (static_cast<int>(chunk.scalar_type()) != static_cast<int>(options.frame_format)) {
      return violation("a chunk of a clip has scalar type " + std::to_string(chunk.scalar_type()) + "; " +
                       std::to_string(static_cast<int>(options.frame_format)) + " was asked for");
    }
    const std::size_t held = clip.rows.size();
    const Span<const float> origin(chunk.root_origin_m().data(), static_cast<std::size_t>(chunk.root_origin_m_size()));
    const Span<const float> before =
        held == 0 ? Span<const float>() : Span<const float>(&clip.rows[held - clip.rig.row_width], clip.rig.row_width);
    ChunkBytes bytes(chunk.data());
    Status begun = decoder->begin(bytes, chunk.frame_count(), origin, before);
    if (!begun) return begun;
    clip.rows.resize(held + std::size_t{chunk.frame_count()} * clip.rig.row_width);
    decoder->take(decoder->num_bytes(), clip.rows.data() + held);
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
  if (!call.made) return call.made;
  const auto stub = v1::MotionService::NewStub(server().channel);
  const auto reader = stub->GenerateClip(&call.context, request_of(options));
  std::vector<Sample> samples(options.num_samples);
  v1::GenerateClipResponse part;
  Status broken;
  while (broken && reader->Read(&part)) {
    broken = part.sample() < samples.size()
                 ? samples[part.sample()].take(part, *known, options)
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
