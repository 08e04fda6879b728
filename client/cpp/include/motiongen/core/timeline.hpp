// Frames by number, the playhead that walks over them, and what a replan replaces. No network, no clock, no thread.
//
// The rule of the protocol, as this class applies it:
//  - a plan notice drops every buffered frame from `valid_from` on; the plan's chunks supply them again, without a gap;
//  - frames below `committed_to` never change, and `committed_to` never falls;
//  - a frame that was shown stays as it was shown. Should a plan reach behind the playhead all the same, its frames up
//    to the playhead are left out and `late_plans` counts it;
//  - when the next frame is not there yet, the last one is held, and `underruns` counts each frame time it is held for;
//  - where a replan or a hold makes what `sample` shows jump, the jump is faded out; at a cut nothing is blended.
//
// Once it has as many rows as it ever holds at a time, nothing here asks for memory.
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

// Where the rows of a chunk come from, in order: float32, little endian.
class MOTIONGEN_API RowSource {
 public:
  virtual ~RowSource() = default;
  // How many bytes there are in all.
  virtual std::size_t num_bytes() const = 0;
  // The next bytes, copied to `to`; a `to` of nullptr passes over them. There are that many left.
  virtual void take(std::size_t count, void* to) = 0;
};

// Rows that lie in memory one after another.
class MOTIONGEN_API RowSpan final : public RowSource {
 public:
  explicit RowSpan(Span<const float> numbers) : numbers_(numbers) {}
  std::size_t num_bytes() const override { return numbers_.size() * sizeof(float); }
  void take(std::size_t count, void* to) override;

 private:
  Span<const float> numbers_;
  std::size_t taken_ = 0;
};

// The greatest number that a frame can have.
inline constexpr std::uint64_t kLastFrame = std::uint64_t{1} << 53;

// Consecutive frames of a plan, as they come from the wire.
struct ChunkHeader {
  std::uint32_t plan = 0;
  std::uint64_t first_frame = 0;
  std::uint32_t num_frames = 0;
  std::uint64_t committed_to = 0;
};

struct TimelineOptions {
  static constexpr std::uint32_t kKeepAll = 0xFFFFFFFF;
  static constexpr std::uint32_t kMostKept = 1 << 20;  // else

  double frame_rate_hz = 20;
  std::uint32_t row_width = 0;  // floats of a frame row
  std::uint64_t start_frame = 0;
  std::uint32_t keep_frames = 0;     // behind the playhead that stay readable; kKeepAll grows for ever
  std::uint32_t reserve_frames = 0;  // ahead of the playhead that there is room for from the start
  double blend_s = 0.15;             // how long a jump of what `sample` shows takes to fade; 0: it is shown
};

// The frames from `first` up to `end` - 1; none where they are equal.
struct FrameRange {
  std::uint64_t first = 0;
  std::uint64_t end = 0;
  std::uint64_t size() const { return end - first; }
};

class MOTIONGEN_API Timeline {
 public:
  // As much of frames ahead of the playhead is held, in bytes; more is a violation, which no credit asks for.
  static constexpr std::uint64_t kMostAheadBytes = std::uint64_t{1} << 28;

  // INVALID_ARGUMENT for a frame rate or a row width of 0.
  static Result<Timeline> make(const TimelineOptions& options);

  Timeline(Timeline&&) noexcept;
  Timeline& operator=(Timeline&&) noexcept;
  ~Timeline();

  // ---- what comes from the server

  // Take a plan notice: drop what it replaces. A violation when the plan would replace committed frames or is not a
  // newer one; then nothing has changed. is_cut: its first frame does not continue the one before.
  [[nodiscard]] Status announce_plan(std::uint32_t plan, std::uint64_t valid_from, bool is_cut = false);

  // Take the frames of a chunk. A violation when they do not belong to the latest plan, do not follow on the frames
  // received so far, are not as many bytes as they should be, or take a commitment back; then nothing has changed.
  [[nodiscard]] Status add_chunk(const ChunkHeader& header, RowSource& rows);

  // A cut that was asked for is at a frame: no plan says so to a session that was away when it was made.
  void note_cut(std::uint64_t frame);

  // Another session goes on where this one was left: its plans count from 1 again, and its first frame is
  // `buffered_to`. Frames that are held stay.
  void continue_with_new_plans();

  // ---- playing. now_s: seconds of any clock that never goes back

  // Move the playhead to where real time says, as far as frames are there. Returns the frames newly reached. The first
  // call that finds a frame starts the clock and shows it. After a hold the next frame comes at once and the ones after
  // it in their time: nothing is skipped.
  FrameRange advance(double now_s);

  // Move the playhead to `frame` whatever the time. OUT_OF_RANGE when it is behind the playhead or not there yet.
  [[nodiscard]] Result<FrameRange> advance_to(std::uint64_t frame);

  // The pose to show now, between the frame of the playhead and the next one; `advance` is part of it. out: row_width
  // floats, left as they are until a frame has come. Returns whether there was one.
  bool sample(double now_s, const Rig& rig, Span<float> out);
  // The same where something else has moved the playhead.
  bool sample_here(double now_s, const Rig& rig, Span<float> out);

  void pause();
  void resume();  // the clock starts anew with the next `advance`
  // Play at another pace from the next `advance` on: 0.5 is half as fast. INVALID_ARGUMENT unless it is above 0.
  [[nodiscard]] Status set_time_scale(double scale);

  // ---- reading

  // row_width floats of a frame, valid until the next call that is not const. OUT_OF_RANGE when it is not held.
  [[nodiscard]] Result<Span<const float>> row(std::uint64_t frame) const;

  bool is_cut(std::uint64_t frame) const;                              // whether it does not continue the one before
  std::optional<std::uint64_t> cut_before(std::uint64_t frame) const;  // the newest such frame below one, of those kept

  bool started() const;               // whether a frame has been shown; until then the playhead stands before the first
  std::uint64_t playhead() const;     // the frame being shown
  float share() const;                // how far what `sample` showed last is on the way to the next frame, 0 to 1
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

  struct State;  // of the library alone

 private:
  explicit Timeline(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
