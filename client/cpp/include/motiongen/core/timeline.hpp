// Timeline: frames by number, the playhead that advances over them, and what a replan replaces. No network, clock or
// thread.
//
// It applies the rules of the protocol as follows:
//  - a plan notice drops every buffered frame from `valid_from` on; the plan's chunks supply them again, without a gap;
//  - frames below `committed_to` never change, and `committed_to` never falls;
//  - a frame that was shown stays as it was shown. If a plan reaches behind the playhead all the same, its frames up to
//    the playhead are dropped and `late_plans` counts the plan;
//  - if the next frame is not there when it is due, the last one is held, and `underruns` counts the frame times held;
//  - if a replan or a hold makes what `sample` shows jump, the jump is faded out; at a cut nothing is blended.
//
// Once it has as many rows as it ever holds at a time, it allocates no memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

// The source of a chunk's rows, in order: float32, little endian.
class MOTIONGEN_API RowSource {
 public:
  virtual ~RowSource() = default;
  // How many bytes there are, before any is taken.
  virtual std::size_t num_bytes() const = 0;
  // Copies the next `count` bytes to `to`, or skips them if `to` is nullptr. `count` is at most what is left.
  virtual void take(std::size_t count, void* to) = 0;
};

// Rows that are consecutive in memory.
class MOTIONGEN_API RowSpan final : public RowSource {
 public:
  explicit RowSpan(Span<const float> numbers) : numbers_(numbers) {}
  std::size_t num_bytes() const override { return numbers_.size() * sizeof(float); }
  void take(std::size_t count, void* to) override;

 private:
  Span<const float> numbers_;
  std::size_t taken_ = 0;
};

// The highest frame number.
inline constexpr std::uint64_t kLastFrame = std::uint64_t{1} << 53;

// The header of a chunk: consecutive frames of a plan.
struct ChunkHeader {
  std::uint32_t plan = 0;
  std::uint64_t first_frame = 0;
  std::uint32_t num_frames = 0;
  std::uint64_t committed_to = 0;
};

struct TimelineOptions {
  static constexpr std::uint32_t kKeepAll = 0xFFFFFFFF;
  static constexpr std::uint32_t kMostKept = 1 << 20;  // of any other number

  double frame_rate_hz = 20;
  std::uint32_t row_width = 0;  // floats of a frame row
  std::uint64_t start_frame = 0;
  // Frames behind the playhead that stay readable, beside those that `advance` has just reached; kKeepAll: all of them,
  // so that memory grows for ever.
  std::uint32_t keep_frames = 0;
  std::uint32_t reserve_frames = 0;  // frames ahead of the playhead for which memory is reserved at the start
  double blend_s = 0.15;             // how long a jump in what `sample` shows takes to fade out; 0: jumps are shown
};

// The frames from `first` to `end` - 1; none if they are equal.
struct FrameRange {
  std::uint64_t first = 0;
  std::uint64_t end = 0;
  std::uint64_t size() const { return end - first; }
};

class MOTIONGEN_API Timeline {
 public:
  // The most bytes of frames held ahead of the playhead. More is a violation: no look-ahead asks for so much.
  static constexpr std::uint64_t kMostAheadBytes = std::uint64_t{1} << 28;

  // INVALID_ARGUMENT for a frame rate or a row width of 0.
  static Result<Timeline> make(const TimelineOptions& options);

  Timeline(Timeline&&) noexcept;
  Timeline& operator=(Timeline&&) noexcept;
  ~Timeline();

  // ---- from the server

  // Take a plan notice and drop the frames that it replaces. A violation if the plan would replace committed frames or
  // is not newer; nothing has changed then. is_cut: the plan's first frame does not continue the one before. If that
  // was shown already, the first that can be replaced does not.
  [[nodiscard]] Status announce_plan(std::uint32_t plan, std::uint64_t valid_from, bool is_cut = false);

  // Take the frames of a chunk. A violation if they do not belong to the latest plan, come before any, do not follow
  // the frames received so far, have the wrong number of bytes, or lower `committed_to`; nothing has changed then.
  [[nodiscard]] Status add_chunk(const ChunkHeader& header, RowSource& rows);

  // Note that a requested cut is at a frame, for a session that was disconnected when the plan with the cut was
  // announced. Returns the frame at which it shows: the first that could be replaced, if its own was shown before it
  // was known.
  std::uint64_t note_cut(std::uint64_t frame);

  // A new session continues this one: its plans count from 1 again, and its first frame is `buffered_to`. Frames that
  // are held stay.
  void continue_with_new_plans();

  // ---- playing. now_s: seconds of any clock that never goes back; at a time that is not finite nothing moves

  // Move the playhead to where it should be at now_s, as far as frames are there. Returns the frames newly reached. The
  // first call that finds a frame shows it and starts the clock. After a hold the next frame is shown at once and
  // playback continues from there at its normal pace: nothing is skipped.
  FrameRange advance(double now_s);

  // Move the playhead to `frame`, whatever the time. OUT_OF_RANGE if it is behind the playhead or not there yet.
  [[nodiscard]] Result<FrameRange> advance_to(std::uint64_t frame);

  // The pose to show now, interpolated between the playhead's frame and the next; calls `advance` itself. out:
  // row_width floats, unchanged if no frame has arrived yet. Returns whether there was a pose.
  bool sample(double now_s, const Rig& rig, Span<float> out);
  // The same without `advance`, where the caller has moved the playhead.
  bool sample_here(double now_s, const Rig& rig, Span<float> out);

  void pause();
  void resume();  // the clock starts anew with the next `advance`
  // Play at another pace from the next `advance` on: 0.5 is half as fast. INVALID_ARGUMENT unless `scale` is above 0.
  [[nodiscard]] Status set_time_scale(double scale);

  // ---- reading

  // The row_width floats of a frame, valid until the next non-const call. OUT_OF_RANGE if it is not held.
  [[nodiscard]] Result<Span<const float>> row(std::uint64_t frame) const;

  bool is_cut(std::uint64_t frame) const;  // whether the frame does not continue the one before
  std::optional<std::uint64_t> cut_before(std::uint64_t frame) const;  // the newest such frame below, of those kept

  bool started() const;               // whether a frame has been shown; until then nothing is at the playhead
  std::uint64_t playhead() const;     // the frame being shown
  float share() const;                // how far the last `sample` was on the way to the next frame, 0 to 1
  std::uint64_t buffered_to() const;  // the first frame that is not held
  std::uint64_t received_to() const;  // where the next chunk must begin
  std::uint64_t first_kept() const;   // the oldest frame that can still be read
  std::uint64_t committed_to() const;
  std::uint32_t plan() const;
  std::uint32_t underruns() const;
  std::uint32_t late_plans() const;
  bool playing() const;
  std::uint32_t row_width() const;
  double frame_rate_hz() const;

  struct State;  // private to the library

 private:
  explicit Timeline(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
