// How frames are stored on their way here, and how they become rows of float32.
#pragma once

#include <cstdint>
#include <vector>

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {

// The numbers of ScalarType. f16: half the bytes; quantised: a quarter. docs/protocol.md has their errors.
enum class FrameFormat : std::uint32_t { f32 = 1, f16 = 2, quantised = 3 };

// Bytes of one stored frame.
MOTIONGEN_API std::size_t stored_row_bytes(const Rig& rig, FrameFormat format);

// Chunks of one session, turned into rows as a timeline takes them. Asks for memory when it is made only.
class MOTIONGEN_API FrameDecoder final : public RowSource {
 public:
  // The rig must outlive it.
  FrameDecoder(const Rig& rig, FrameFormat format);

  // Take a chunk, whose bytes must stay until its rows are taken. origin_m: FrameChunk.root_origin_m, three numbers of
  // f16, else none. before: the row of the frame before, or none; quantised quaternions keep to the signs of its own.
  // A violation when the bytes are not so many rows.
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
  std::vector<std::uint8_t> bytes_;  // of one stored frame
  std::vector<float> row_;           // the last that was taken
  std::vector<float> before_;
};

}  // namespace motiongen
