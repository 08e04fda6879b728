// The pose at a moment between two frames; jumps in what is shown are faded out.
#include <algorithm>
#include <cmath>

#include "motiongen/core/pose.hpp"
#include "quaternion.hpp"
#include "timeline_state.hpp"

namespace motiongen {
namespace {

constexpr Quaternion kNoTurn = {1, 0, 0, 0};

// Whether the frame being approached has been replaced since, or arrived only after the last pose had to be held.
bool has_jumped(Timeline::State& s, bool is_there) {
  const bool same_next = s.approached && s.replaced_from > s.shown_frame + 1;
  if (s.playhead == s.shown_frame) return is_there ? !same_next : s.approached;
  if (s.has_cut(s.shown_frame, s.playhead)) {
    s.fading = false;  // the fading gap belongs to the place before the cut
    return false;
  }
  return s.playhead == s.shown_frame + 1 && !same_next;
}

// Keep the gap between what was shown and what is due.
void keep_gap(Timeline::State& s, const Rig& rig, Span<const float> due) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    s.apart[axis] = s.shown[rig.root_column + axis] - due[rig.root_column + axis];
  }
  for (std::size_t joint = 0; joint < rig.num_joints(); ++joint) {
    const std::size_t column = rig.rotation_column + 4 * joint;
    store(multiply(load(&s.shown[column]), inverse(load(&due[column]))), &s.apart[3 + 4 * joint]);
  }
}

// Add a share of the gap to what is due.
void bridge(const Timeline::State& s, const Rig& rig, float weight, Span<float> row) {
  for (std::size_t axis = 0; axis < 3; ++axis) row[rig.root_column + axis] += weight * s.apart[axis];
  for (std::size_t joint = 0; joint < rig.num_joints(); ++joint) {
    const std::size_t column = rig.rotation_column + 4 * joint;
    const Quaternion part = slerp(kNoTurn, load(&s.apart[3 + 4 * joint]), weight);
    store(multiply(part, load(&row[column])), &row[column]);
  }
}

}  // namespace

bool Timeline::sample(double now_s, const Rig& rig, Span<float> out) {
  advance(now_s);
  return sample_here(now_s, rig, out);
}

bool Timeline::sample_here(double now_s, const Rig& rig, Span<float> out) {
  State& s = *state_;
  if (!s.started) return false;
  if (!std::isfinite(now_s)) now_s = s.shown_at_s;
  s.shown_at_s = now_s;
  const bool is_there = s.buffered_to() > s.playhead + 1;
  const bool may_mix = is_there && !s.is_cut(s.playhead + 1);
  if (s.playing && may_mix) {
    const bool is_running = is_set(s.due_s) && !is_set(s.held_since_s);
    s.blend = is_running ? static_cast<float>(std::clamp(1 - (s.due_s - now_s) * s.pace_hz, 0.0, 1.0)) : 0;
  }
  const Span<const float> here = s.row(s.playhead);
  if (may_mix && s.blend > 0) {
    interpolate(rig, here, s.row(s.playhead + 1), s.blend, out);
  } else {
    std::copy(here.begin(), here.end(), out.begin());
  }
  const double blend_s = s.options.blend_s;
  if (s.has_shown && has_jumped(s, is_there)) {
    keep_gap(s, rig, out);
    s.fading = true;
    s.faded_at_s = now_s + blend_s;
  }
  const double left = s.fading && blend_s > 0 ? (s.faded_at_s - now_s) / blend_s : 0;
  s.fading = left > 0;
  // smoothstep: begins and ends smoothly
  if (s.fading) bridge(s, rig, static_cast<float>(left * left * (3 - 2 * left)), out);
  std::copy(out.begin(), out.begin() + s.options.row_width, s.shown.begin());
  s.has_shown = true;
  s.shown_frame = s.playhead;
  s.approached = is_there;
  s.replaced_from = kNoFrame;
  return true;
}

}  // namespace motiongen
