// Reading and playing a session's frames, which its timeline holds.
#include <algorithm>
#include <cmath>

#include "client/core.hpp"
#include "motiongen/client/session.hpp"

namespace motiongen {
namespace {

Status too_short(Span<float> out, const Rig& rig) {
  return invalid("out", std::to_string(out.size()) + " floats", std::to_string(rig.row_width) + " or more");
}

}  // namespace

const Rig& Session::rig() const {
  static const Rig none;
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline ? state_->rig : none;  // never changes once set
}

bool Session::is_open() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline.has_value() && state_->phase != Phase::closed;
}

bool Session::is_durable() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->is_durable;
}

bool Session::is_closed() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->phase == Phase::closed || state_->phase == Phase::closing;
}

bool Session::sample(Span<float> out) {
  const auto shown = show(nullptr, out);
  return shown && shown.value();
}

Result<bool> Session::sample_on_ground(GroundFollower& ground, Span<float> out) { return show(&ground, out); }

Result<bool> Session::show(GroundFollower* ground, Span<float> out) {
  bool shown = false;
  bool began = false;
  Status raised;
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->timeline) return false;
    if (out.size() < state_->rig.row_width) return too_short(out, state_->rig);
    began = !state_->timeline->started();
    shown = state_->options.clock == Clock::manual ? state_->timeline->sample_here(now_s(), state_->rig, out)
                                                   : state_->timeline->sample(now_s(), state_->rig, out);
    if (shown && ground != nullptr) raised = ground->apply(*state_->timeline, out);
    began = began && shown;
    if (began) state_->report(now_s(), core_->report_period_s(), core_->outbox());
  }
  if (began) core_->flush();  // the server starts its estimate of our clock at this report
  if (!raised) return raised;
  return shown;
}

std::optional<std::uint64_t> Session::frame(Span<float> out) {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  if (!state_->timeline || out.size() < state_->rig.row_width) return std::nullopt;
  if (state_->options.clock == Clock::real_time) state_->timeline->advance(now_s());
  if (!state_->timeline->started()) return std::nullopt;
  const auto row = state_->timeline->row(state_->timeline->playhead());
  std::copy(row.value().begin(), row.value().end(), out.begin());
  return state_->timeline->playhead();
}

Status Session::copy_frame(std::uint64_t frame, Span<float> out) const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  if (!state_->timeline) return {Code::failed_precondition, "NOT_OPEN", "the session has not opened yet"};
  if (out.size() < state_->rig.row_width) return too_short(out, state_->rig);
  const auto row = state_->timeline->row(frame);
  if (!row) return row.status();
  std::copy(row.value().begin(), row.value().end(), out.begin());
  return {};
}

Status Session::advance_to(std::uint64_t frame) {
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->timeline) return {Code::failed_precondition, "NOT_OPEN", "the session has not opened yet"};
    if (state_->options.clock != Clock::manual) {
      return {Code::failed_precondition, "NOT_MANUAL",
              "the library moves the playhead; open with Clock::manual to move it"};
    }
    Status shown = state_->advance_to(frame);
    if (!shown) return shown;
  }
  core_->wake();
  return {};
}

Status Session::set_time_scale(double scale) {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  if (!state_->timeline) return {Code::failed_precondition, "NOT_OPEN", "the session has not opened yet"};
  return state_->timeline->set_time_scale(scale);
}

std::uint64_t Session::playhead() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline ? state_->timeline->playhead() : 0;
}

std::uint64_t Session::buffered_to() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline ? state_->timeline->buffered_to() : 0;
}

std::uint64_t Session::frame_in(double seconds) const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  if (!state_->timeline || !(seconds >= 0)) return 0;
  const double frames = std::min(seconds * state_->timeline->frame_rate_hz(), static_cast<double>(kLastFrame));
  return state_->timeline->playhead() + static_cast<std::uint64_t>(std::llround(frames));
}

SessionStats Session::stats() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  SessionStats stats = state_->stats;
  if (state_->timeline) {
    stats.underruns = state_->timeline->underruns();
    stats.late_plans = state_->timeline->late_plans();
  }
  return stats;
}

}  // namespace motiongen
