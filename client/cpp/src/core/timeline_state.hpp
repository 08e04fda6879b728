// The state of a timeline: its rows, the playhead and the clock that moves it, and what was shown last.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "motiongen/core/timeline.hpp"
#include "row_store.hpp"

namespace motiongen {

// A frame counts as due this share of a frame time early, since frame times are not exact binary fractions.
constexpr double kEarlyFrames = 1e-6;
constexpr double kNever = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint64_t kNoFrame = std::numeric_limits<std::uint64_t>::max();

inline bool is_set(double moment_s) { return !std::isnan(moment_s); }

struct Timeline::State {
  State(const TimelineOptions& given, std::size_t capacity)
      : options(given),
        rows(given.row_width, capacity),
        pace_hz(given.frame_rate_hz),
        next_pace_hz(given.frame_rate_hz),
        shown(given.row_width),
        apart(given.row_width) {
    cuts.reserve(8);
  }

  TimelineOptions options;
  RowStore rows;
  std::uint64_t playhead = 0;
  std::uint64_t committed_to = 0;
  std::uint64_t first_kept = 0;
  std::uint64_t received_to = 0;  // where the next chunk must begin; below buffered_to only after a late plan
  std::uint32_t plan = 0;
  std::uint32_t underruns = 0;
  std::uint32_t late_plans = 0;
  bool started = false;
  bool playing = true;
  double pace_hz = 0;       // frames a second at the present time scale
  double next_pace_hz = 0;  // at the time scale that was set last
  double due_s = kNever;    // when the frame after the playhead is due; unset: the clock starts anew
  double held_since_s = kNever;
  std::uint64_t held_frames = 0;
  std::vector<std::uint64_t> cuts;  // kept frames that do not continue the one before, ascending
  FrameRange passed;                // frames that the latest late plan should have replaced, but that were shown

  // ---- what `sample` showed last
  float blend = 0;  // the share of the frame after the playhead
  bool has_shown = false;
  double shown_at_s = 0;
  std::uint64_t shown_frame = 0;           // the playhead at that time
  bool approached = false;                 // the frame after it had arrived
  std::uint64_t replaced_from = kNoFrame;  // the first frame that was replaced since
  std::vector<float> shown;                // the row shown
  std::vector<float> apart;                // what was shown, relative to what was due: 3 for the root, 4 a joint
  bool fading = false;
  double faded_at_s = 0;

  std::uint64_t buffered_to() const { return first_kept + rows.size(); }
  double frame_s() const { return 1 / pace_hz; }
  bool is_cut(std::uint64_t frame) const { return std::binary_search(cuts.begin(), cuts.end(), frame); }
  // Whether any frame above `after`, up to `frame`, is a cut.
  bool has_cut(std::uint64_t after, std::uint64_t frame) const {
    const auto next = std::upper_bound(cuts.begin(), cuts.end(), after);
    return next != cuts.end() && *next <= frame;
  }
  Span<const float> row(std::uint64_t frame) const { return {rows.row(frame - first_kept), options.row_width}; }

  void start(std::uint64_t frame) {
    started = true;
    playhead = frame;
  }

  FrameRange move(std::uint64_t count) {
    const std::uint64_t first = playhead + 1;
    playhead += count;
    if (count > 0) blend = 0;
    if (is_set(due_s)) due_s += static_cast<double>(count) / pace_hz;
    return {first, playhead + 1};
  }

  // Run at the pace set last. What is over of a frame time counts, or setting it all the time would stop the clock.
  void take_next_pace(double now_s) {
    if (next_pace_hz == pace_hz) return;
    due_s = now_s + (due_s - now_s) * pace_hz / next_pace_hz;  // unset ones stay unset
    held_since_s = now_s + (held_since_s - now_s) * pace_hz / next_pace_hz;
    pace_hz = next_pace_hz;
  }

  // Raise the frame count of the present hold, and underruns with it.
  void count_held(std::uint64_t frames) {
    if (frames <= held_frames) return;
    underruns += static_cast<std::uint32_t>(frames - held_frames);
    held_frames = frames;
  }

  // Drop old frames, all of them before a frame: those that were newly reached are still to be read.
  void forget(std::uint64_t before) {
    if (options.keep_frames == TimelineOptions::kKeepAll || playhead < options.keep_frames) return;
    const std::uint64_t end = std::min(playhead - options.keep_frames, before);
    if (end <= first_kept) return;
    rows.drop_front(end - first_kept);
    first_kept = end;
  }
};

}  // namespace motiongen
