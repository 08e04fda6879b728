// Moves the playhead of a timeline, by the clock or by hand.
#include "timeline_state.hpp"

namespace motiongen {
namespace {

std::uint64_t count_of(double value) { return value <= 0 ? 0 : static_cast<std::uint64_t>(std::min(value, 1e15)); }

}  // namespace

FrameRange Timeline::advance(double now_s) {
  State& s = *state_;
  if (!std::isfinite(now_s) || !s.playing || (!s.started && s.rows.size() == 0)) return {};
  if (!s.started) {
    s.pace_hz = s.next_pace_hz;
    s.due_s = now_s + s.frame_s();
    s.start(s.playhead);
    return {s.playhead, s.playhead + 1};
  }
  if (!is_set(s.due_s)) s.due_s = now_s + s.frame_s() * (1 - static_cast<double>(s.blend));
  const std::uint64_t left = s.buffered_to() - 1 - s.playhead;
  if (is_set(s.held_since_s) && left > 0) {
    s.count_held(count_of(std::ceil((now_s - s.held_since_s) * s.pace_hz - kEarlyFrames)));
    s.held_since_s = kNever;
    s.due_s = now_s;
  }
  const std::uint64_t due = count_of(std::floor((now_s - s.due_s) * s.pace_hz + kEarlyFrames) + 1);
  const FrameRange reached = s.move(std::min(due, left));
  s.forget(reached.first);
  if (due > left) {
    if (!is_set(s.held_since_s)) {
      s.held_since_s = s.due_s;
      s.held_frames = 0;
    }
    s.count_held(count_of(std::floor((now_s - s.held_since_s) * s.pace_hz + kEarlyFrames) + 1));
  }
  s.take_next_pace(now_s);
  return reached;
}

Result<FrameRange> Timeline::advance_to(std::uint64_t frame) {
  State& s = *state_;
  if (frame < s.playhead || frame >= s.buffered_to()) {
    const std::string allowed = s.buffered_to() > s.playhead ? "from " + std::to_string(s.playhead) + " to " +
                                                                   std::to_string(s.buffered_to() - 1)
                                                             : "none before frames have come";
    return Status(Code::out_of_range, "FRAME_NOT_HELD",
                  "frame: " + std::to_string(frame) + " was given; allowed is " + allowed);
  }
  const std::uint64_t before = s.playhead;
  FrameRange reached;
  if (s.started) {
    reached = s.move(frame - s.playhead);
  } else {
    s.start(frame);
    reached = {before, frame + 1};
  }
  s.forget(frame);
  s.due_s = s.held_since_s = kNever;
  s.blend = 0;
  return reached;
}

void Timeline::pause() { state_->playing = false; }

void Timeline::resume() {
  state_->playing = true;
  state_->due_s = state_->held_since_s = kNever;
}

Status Timeline::set_time_scale(double scale) {
  const double pace_hz = state_->options.frame_rate_hz * scale;
  if (!(pace_hz > 0) || !std::isfinite(pace_hz) || !std::isfinite(1 / pace_hz)) {
    return invalid("scale", std::to_string(scale), "a number above 0; pause to stand still");
  }
  state_->next_pace_hz = pace_hz;
  return {};
}

}  // namespace motiongen
