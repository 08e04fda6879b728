#include "client/clip_sample.hpp"

#include <cstring>
#include <string>

#include "client/convert.hpp"

namespace motiongen {
namespace {

// The bytes of a parsed FrameChunk.
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

}  // namespace

Status ClipSample::take(const v1::GenerateClipResponse& part, const Catalog& catalog, const ClipOptions& options) {
  if (is_whole) return violation("a part of a clip came after its summary");
  if (part.has_opened()) return take_opened(part.opened(), catalog, options);
  if (part.has_chunk()) return take_chunk(part.chunk(), options);
  return part.has_summary() ? take_summary(part.summary(), options) : Status();
}

Status ClipSample::take_opened(const v1::SessionOpened& message, const Catalog& catalog, const ClipOptions& options) {
  if (decoder) return violation("a clip was opened twice");  // its rows have the layout of the first rig
  auto rig = convert::session_rig(catalog, message, options.outputs);
  if (!rig) return rig.status();
  Status fits = convert::check_placements(message.placements_size());
  if (!fits) return fits;
  clip.opened = convert::opened(message);
  clip.rig = std::move(rig).value();
  decoder.emplace(clip.rig, options.frame_format);
  return {};
}

Status ClipSample::take_chunk(const v1::FrameChunk& chunk, const ClipOptions& options) {
  if (!decoder) return violation("a chunk of a clip came before it was opened");
  if (chunk.first_frame() != clip.num_frames) {
    return violation("frame " + std::to_string(chunk.first_frame()) + " of a clip came after " +
                     std::to_string(clip.num_frames) + " frames");
  }
  if (chunk.frame_count() > options.num_frames - clip.num_frames) {
    return violation(std::to_string(chunk.frame_count()) + " frames of a clip came after " +
                     std::to_string(clip.num_frames) + "; " + std::to_string(options.num_frames) + " were asked for");
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

Status ClipSample::take_summary(const v1::ClipSummary& summary, const ClipOptions& options) {
  const auto given = static_cast<std::size_t>(summary.residuals_size());
  if (given != options.targets.size()) {
    return violation(std::to_string(given) + " residuals of a clip came for " + std::to_string(options.targets.size()) +
                     " targets");
  }
  for (const auto& each : summary.residuals()) clip.residuals.push_back(convert::residual(each));
  is_whole = true;
  return {};
}

}  // namespace motiongen
