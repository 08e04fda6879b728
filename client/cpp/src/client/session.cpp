// What a session is told: locks it, makes the event, and lets it go out.
#include "motiongen/client/session.hpp"

#include <cmath>

#include "client/convert.hpp"
#include "client/core.hpp"

namespace motiongen {
namespace {

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

}  // namespace motiongen
