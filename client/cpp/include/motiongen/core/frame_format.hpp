// How frames are encoded on the wire, and their decoding to rows of float32.
#pragma once

#include <cstdint>
#include <vector>

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {

// The numbers are those of ScalarType. f16: half the bytes; quantised: a quarter. docs/protocol.md states their errors.
enum class FrameFormat : std::uint32_t { f32 = 1, f16 = 2, quantised = 3 };

// Bytes of one stored frame.
MOTIONGEN_API std::size_t stored_row_bytes(const Rig& rig, FrameFormat format);

// Decodes the chunks of one session to rows, as a timeline takes them. Allocates memory only in its constructor.
class MOTIONGEN_API FrameDecoder final : public RowSource {
 public:
  // The rig must outlive it.
  FrameDecoder(const Rig& rig, FrameFormat format);

  // Begin a chunk, whose bytes must stay valid until its rows are taken. origin_m: FrameChunk.root_origin_m, three
  // numbers with f16, else empty. before: the row of the frame before, or empty; the signs of quantised quaternions are
  // chosen to match it. A violation if the bytes are not as many rows.
  [[nodiscard]] Status begin(RowSource& stored, std::uint32_t num_frames, Span<const float> origin_m,
                             Span<const float> before);

  std::size_t num_bytes() const override { return left_ * row_.size() * sizeof(float); }
  // Whole rows only.
  void take(std::size_t count, void* to) override;

 private:
  void decode_halves();
  void decode_quantised();
  void decode_output(const Block& output, std::size_t column, const std::uint8_t* from);
  void decode_rotations(std::size_t column, std::size_t count, const std::uint8_t* from);

  const Rig& rig_;
  const FrameFormat format_;
  RowSource* stored_ = nullptr;
  std::size_t left_ = 0;
  float origin_m_[3] = {0, 0, 0};
  bool has_before_ = false;
  std::vector<std::uint8_t> bytes_;  // one stored frame
  std::vector<float> row_;           // the row taken last
  std::vector<float> before_;
};

}  // namespace motiongen
