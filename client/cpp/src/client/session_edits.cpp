// A session's edits: each locks the session, makes the event, and has it sent.
#include <cmath>

#include "client/convert.hpp"
#include "client/core.hpp"
#include "motiongen/client/session.hpp"

namespace motiongen {
namespace {

constexpr double kUsualFrameRateHz = 20;  // for an unknown model, which the server will refuse

Status check_span(const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame) {
  Status checked = convert::check(prompt);
  if (checked && end_frame != 0 && end_frame <= start_frame) {
    checked = invalid("end_frame", std::to_string(end_frame), "above start_frame, or 0 for until another takes over");
  }
  return checked;
}

Status unknown_id(const char* field, std::uint32_t id) {
  return invalid(field, std::to_string(id), "an id that an earlier call gave");
}

}  // namespace

Result<EditId> Session::set_prompt(const Prompt& prompt) {
  Status checked = convert::check(prompt);
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
  Status checked = check_span(prompt, start_frame, end_frame);
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

Result<EditId> Session::replace_prompt(std::uint32_t prompt_id, const Prompt& prompt, std::uint64_t start_frame,
                                       std::uint64_t end_frame) {
  Status checked = check_span(prompt, start_frame, end_frame);
  if (!checked) return checked;
  v1::SessionEvent event;
  *event.mutable_edit_prompts()->add_upsert() = convert::span(prompt_id, prompt, start_frame, end_frame);
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->book.knows_prompt(prompt_id)) return unknown_id("prompt_id", prompt_id);
  }
  return core_->edit(*state_, std::move(event));
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

Result<EditId> Session::replace_target(std::uint32_t id, const Target& target) {
  Status checked = convert::check(target);
  if (!checked) return checked;
  v1::SessionEvent event;
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(id, target);
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->book.knows_constraint(id)) return unknown_id("id", id);
  }
  auto sent = core_->edit_with(*state_, [&] {
    state_->reached_book.forget(id);
    return std::move(event);
  });
  if (!sent) {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->book.is_being_set(id)) state_->reached_book.settle(id, false, true);
  }
  return sent;
}

Result<EditId> Session::go_to(float x_m, float z_m, std::optional<float> heading_rad, bool relative_to_character,
                              std::uint32_t* id) {
  Target target = Waypoint{0, x_m, z_m, heading_rad, {}};
  target.at_any_frame = true;
  target.relative_to_character = relative_to_character;
  return add_target(target, id);
}

Result<EditId> Session::follow_path(Span<const float> corners_m, std::optional<float> speed_mps,
                                    std::optional<float> smoothing_m, std::uint32_t* id) {
  return add_target(RootPath{{corners_m.begin(), corners_m.end()}, speed_mps, smoothing_m, {}}, id);
}

Result<EditId> Session::add_target(const Target& target, std::uint32_t* id) {
  std::vector<std::uint32_t> ids;
  auto sent = edit_targets({&target, 1}, &ids, false);
  if (sent && id != nullptr) *id = ids[0];
  return sent;
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
    const double rate = frame_rate_hz();
    velocity->set_hold_frames(static_cast<std::uint32_t>(std::lround(seconds * rate)));
    velocity->set_keep_prompt(keep_prompt);
    return event;
  });
}

// Before the session has opened, that of the rig it will have. With the state's mutex held.
double Session::frame_rate_hz() const {
  if (state_->timeline) return state_->timeline->frame_rate_hz();
  const auto known = core_->catalog();
  const Rig* rig = convert::find_rig(*known, state_->options.model_id);
  return rig != nullptr ? rig->frame_rate_hz : kUsualFrameRateHz;
}

Result<EditId> Session::pause() { return play(true); }
Result<EditId> Session::resume() { return play(false); }

Result<EditId> Session::play(bool paused) {
  return core_->edit_with(*state_, [&] {
    v1::SessionEvent event;
    event.mutable_set_play_state()->set_state(paused ? v1::PLAY_STATE_PAUSED : v1::PLAY_STATE_PLAYING);
    return event;
  });
}

Result<EditId> Session::teleport(float x_m, float z_m, float heading_rad) {
  if (!std::isfinite(x_m) || !std::isfinite(z_m) || !std::isfinite(heading_rad)) {
    return invalid("teleport", "a number that is not finite", "finite metres and radians");
  }
  v1::SessionEvent event;
  auto* pose = event.mutable_seek()->mutable_start_pose();
  pose->set_x(x_m);
  pose->set_z(z_m);
  pose->set_heading(heading_rad);
  return core_->edit(*state_, std::move(event));
}

Result<EditId> Session::cut_to(Span<const float> rows) {
  const Rig& known = rig();
  if (known.row_width == 0) return Status(Code::failed_precondition, "NOT_OPEN", "the session has not opened yet");
  Status checked = convert::check_rows(rows, known.row_width);
  if (!checked) return checked;
  v1::SessionEvent event;
  convert::set_rows(rows, known, event.mutable_seek()->mutable_prior_frames());
  return core_->edit(*state_, std::move(event));
}

Result<EditId> Session::seek(std::uint64_t frame) {
  if (frame == 0) return invalid("frame", "0", "a frame from 1 on: none is before the first");
  return core_->edit_with(*state_, [&] { return state_->seek_event(frame, *core_->catalog()); });
}

Result<EditId> Session::set_options(const OptionsChange& change) {
  Status checked = convert::check(change);
  if (!checked) return checked;
  v1::SessionEvent event;
  *event.mutable_set_options() = convert::set_options(change);
  return core_->edit(*state_, std::move(event));
}

}  // namespace motiongen
