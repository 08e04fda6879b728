// The public face of a session: locks it, asks it, and lets what waits go out.
#include "motiongen/client/session.hpp"

#include <chrono>
#include <cmath>

#include "client/convert.hpp"
#include "client/core.hpp"

namespace motiongen {
namespace {

const Status& in_callback() {
  static const Status status(Code::failed_precondition, "IN_CALLBACK",
                             "nothing can be waited for inside an event callback; wait on another thread");
  return status;
}

Status too_long(const char* what, double timeout_s) {
  return {Code::deadline_exceeded, "TIMEOUT",
          std::string(what) + " took longer than " + std::to_string(timeout_s) + " s"};
}

std::chrono::duration<double> of(double seconds) { return std::chrono::duration<double>(seconds); }

Status check_prompt(const Prompt& prompt) {
  const int given = (prompt.text.empty() ? 0 : 1) + (prompt.preset_id.empty() ? 0 : 1);
  if (prompt.empty())
    return invalid("prompt", "nothing", "a text, a preset or an embedding; remove_prompt takes one away");
  if (given == 2) return invalid("prompt", "a text and a preset", "one of them");
  return {};
}

}  // namespace

Session::Session(std::shared_ptr<ClientCore> core, std::shared_ptr<SessionState> state)
    : core_(std::move(core)), state_(std::move(state)) {}
Session::Session(Session&&) noexcept = default;

Session& Session::operator=(Session&& other) noexcept {
  if (this != &other) {
    if (state_ != nullptr) static_cast<void>(close());
    core_ = std::move(other.core_);
    state_ = std::move(other.state_);
  }
  return *this;
}

Session::~Session() {
  if (state_ != nullptr) static_cast<void>(close());
}

std::uint32_t Session::id() const { return state_->id; }

// ---- what it is told

Result<EditId> Session::set_prompt(const Prompt& prompt) {
  Status checked = check_prompt(prompt);
  if (!checked) return checked;
  return core_->edit_with(*state_, [&] {
    v1::SessionEvent event;
    auto* edit = event.mutable_edit_prompts();
    const std::uint64_t playhead = state_->timeline ? state_->timeline->playhead() : 0;
    for (const std::uint32_t id : state_->book.begun_prompts(playhead, false)) edit->add_remove(id);
    *edit->add_upsert() = convert::span(SessionBook::kPresentPrompt, prompt, 0, 0);
    return event;
  });
}

Result<EditId> Session::schedule_prompt(const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame,
                                        std::uint32_t* prompt_id) {
  Status checked = check_prompt(prompt);
  if (!checked) return checked;
  return core_->edit_with(*state_, [&] {
    v1::SessionEvent event;
    auto* edit = event.mutable_edit_prompts();
    const std::uint64_t playhead = state_->timeline ? state_->timeline->playhead() : 0;
    for (const std::uint32_t id : state_->book.begun_prompts(playhead, true)) edit->add_remove(id);
    const std::uint32_t id = state_->book.take_prompt_id();
    if (prompt_id != nullptr) *prompt_id = id;
    *edit->add_upsert() = convert::span(id, prompt, start_frame, end_frame);
    return event;
  });
}

Result<EditId> Session::remove_prompt(std::uint32_t prompt_id) {
  v1::SessionEvent event;
  event.mutable_edit_prompts()->add_remove(prompt_id);
  return core_->edit(*state_, std::move(event));
}

Result<EditId> Session::add_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids) {
  return edit_targets(targets, ids, false);
}

Result<EditId> Session::set_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids) {
  return edit_targets(targets, ids, true);
}

Result<EditId> Session::edit_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids, bool clear) {
  for (const Target& target : targets) {
    Status checked = convert::check(target);
    if (!checked) return checked;
  }
  return core_->edit_with(*state_, [&] {
    v1::SessionEvent event;
    auto* edit = event.mutable_edit_constraints();
    edit->set_clear(clear);
    if (ids != nullptr) ids->clear();
    for (const Target& target : targets) {
      const std::uint32_t id = state_->book.take_constraint_id();
      if (ids != nullptr) ids->push_back(id);
      *edit->add_upsert() = convert::constraint(id, target);
    }
    return event;
  });
}

Result<EditId> Session::remove_targets(Span<const std::uint32_t> ids) {
  v1::SessionEvent event;
  auto* edit = event.mutable_edit_constraints();
  for (const std::uint32_t id : ids) edit->add_remove(id);
  return core_->edit(*state_, std::move(event));
}

Result<EditId> Session::set_velocity(float x_mps, float z_mps, double seconds, std::optional<float> heading_rad,
                                     bool keep_prompt) {
  if (!std::isfinite(x_mps) || !std::isfinite(z_mps) || !std::isfinite(heading_rad.value_or(0))) {
    return invalid("set_velocity", "a number that is not finite", "finite metres a second and radians");
  }
  if (!(seconds >= 0 && seconds <= 1e6)) return invalid("seconds", std::to_string(seconds), "a number of 0 or more");
  return core_->edit_with(*state_, [&] {
    v1::SessionEvent event;
    auto* velocity = event.mutable_set_velocity();
    velocity->set_x(x_mps);
    velocity->set_z(z_mps);
    if (heading_rad) velocity->set_heading(*heading_rad);
    const double rate = state_->timeline ? state_->timeline->frame_rate_hz() : 20;
    velocity->set_hold_frames(static_cast<std::uint32_t>(std::lround(seconds * rate)));
    velocity->set_keep_prompt(keep_prompt);
    return event;
  });
}

Result<EditId> Session::pause() { return play(true); }
Result<EditId> Session::resume() { return play(false); }

Result<EditId> Session::play(bool paused) {
  return core_->edit_with(*state_, [&] {
    if (state_->timeline) paused ? state_->timeline->pause() : state_->timeline->resume();
    v1::SessionEvent event;
    event.mutable_set_play_state()->set_state(paused ? v1::PLAY_STATE_PAUSED : v1::PLAY_STATE_PLAYING);
    return event;
  });
}

Status Session::close() {
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (state_->phase == Phase::closed || state_->phase == Phase::closing) return {};
    const bool must_tell = state_->phase != Phase::waiting;
    if (must_tell) state_->send_close(core_->outbox());
    state_->phase = Phase::closing;
    if (!must_tell) {
      state_->end(Status(Code::cancelled, "CLIENT", "the session was closed here"), core_->events());
    }
  }
  core_->flush();
  return {};
}

// ---- waiting

Result<Opened> Session::wait_open(double timeout_s) {
  if (core_->events().in_callback()) return in_callback();
  std::unique_lock<std::mutex> lock(state_->mutex);
  const auto told = [this] { return state_->timeline.has_value() || state_->phase == Phase::closed; };
  if (!state_->changed.wait_for(lock, of(timeout_s), told)) return too_long("opening the session", timeout_s);
  if (!state_->timeline) return state_->ended;
  return state_->opened;
}

Result<Outcome> Session::wait_edit(EditId edit, double timeout_s) {
  if (core_->events().in_callback()) return in_callback();
  std::unique_lock<std::mutex> lock(state_->mutex);
  std::optional<Outcome> answer;
  const auto told = [&] {
    answer = state_->find_answer(edit);
    return answer || state_->phase == Phase::closed;
  };
  if (!state_->changed.wait_for(lock, of(timeout_s), told)) return too_long("the answer", timeout_s);
  if (!answer) return state_->ended;
  return *answer;
}

Status Session::wait_frame(std::uint64_t frame, double timeout_s) {
  if (core_->events().in_callback()) return in_callback();
  std::unique_lock<std::mutex> lock(state_->mutex);
  const auto there = [&] {
    return state_->phase == Phase::closed || (state_->timeline && state_->timeline->buffered_to() > frame);
  };
  if (!state_->changed.wait_for(lock, of(timeout_s), there)) return too_long("the frame", timeout_s);
  return state_->timeline && state_->timeline->buffered_to() > frame ? Status() : state_->ended;
}

// ---- frames

const Rig& Session::rig() const {
  static const Rig none;
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline ? state_->rig : none;  // which does not change any more
}

bool Session::is_open() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->timeline.has_value() && state_->phase != Phase::closed;
}

bool Session::is_closed() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->phase == Phase::closed || state_->phase == Phase::closing;
}

bool Session::sample(Span<float> out) {
  bool shown = false;
  bool began = false;
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->timeline || out.size() < state_->rig.row_width) return false;
    began = !state_->timeline->started();
    shown = state_->timeline->sample(now_s(), state_->rig, out);
    began = began && shown;
    if (began) state_->report(now_s(), core_->report_period_s(), core_->outbox());
  }
  if (began) core_->flush();  // the server's idea of our clock begins here
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
  if (out.size() < state_->rig.row_width) {
    return invalid("out", std::to_string(out.size()) + " floats", std::to_string(state_->rig.row_width) + " or more");
  }
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
    const bool began = !state_->timeline->started();
    const auto reached = state_->timeline->advance_to(frame);
    if (!reached) return reached.status();
    // nothing left to show: more credit at once, or with the next tick where it was just asked for
    if (began || frame + 1 == state_->timeline->buffered_to()) state_->next_report_s = 0;
  }
  core_->wake();
  return {};
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
  return state_->timeline->playhead() +
         static_cast<std::uint64_t>(std::llround(seconds * state_->timeline->frame_rate_hz()));
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
