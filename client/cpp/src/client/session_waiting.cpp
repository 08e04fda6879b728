// Waiting for answers, results and frames of a session.
#include <chrono>

#include "client/core.hpp"
#include "client/timeouts.hpp"
#include "motiongen/client/session.hpp"

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

Status no_answer(EditId edit) {
  return invalid("edit", std::to_string(edit),
                 "an edit of this session that has no answer yet, or whose answer is among the last that are kept");
}

// Why this call cannot wait, or not for so long.
Status check_wait(const EventQueue& events, double timeout_s) {
  if (events.in_callback()) return in_callback();
  return check_timeout(timeout_s);
}

std::chrono::duration<double> of(double seconds) { return std::chrono::duration<double>(bounded_s(seconds)); }

}  // namespace

Result<Opened> Session::wait_open(double timeout_s) {
  Status checked = check_wait(core_->events(), timeout_s);
  if (!checked) return checked;
  std::unique_lock<std::mutex> lock(state_->mutex);
  const auto told = [this] { return state_->timeline.has_value() || state_->gets_no_more(); };
  if (!state_->changed.wait_for(lock, of(timeout_s), told)) return too_long("opening the session", timeout_s);
  if (!state_->timeline) return state_->ended;
  return state_->opened;
}

Result<Outcome> Session::wait_edit(EditId edit, double timeout_s) {
  Status checked = check_wait(core_->events(), timeout_s);
  if (!checked) return checked;
  if (edit == 0) return no_answer(edit);  // the library's own events have this number
  std::unique_lock<std::mutex> lock(state_->mutex);
  std::optional<Outcome> answer;
  const auto told = [&] {
    answer = state_->find_answer(edit);
    return answer || state_->phase == Phase::closed || !state_->book.is_unanswered(edit);
  };
  if (!state_->changed.wait_for(lock, of(timeout_s), told)) return too_long("the answer", timeout_s);
  if (answer) return *answer;
  return state_->phase == Phase::closed ? state_->ended : no_answer(edit);
}

Result<Reached> Session::wait_reached(std::uint32_t target, double timeout_s) {
  Status checked = check_wait(core_->events(), timeout_s);
  if (!checked) return checked;
  std::unique_lock<std::mutex> lock(state_->mutex);
  if (!state_->book.knows_constraint(target)) {
    return invalid("target", std::to_string(target), "an id that an earlier call gave");
  }
  std::optional<Reached> found;
  std::optional<Status> refused;
  const auto told = [&] {
    found = state_->reached_book.find(target);
    refused = state_->reached_book.find_refusal(target);
    return found || refused || state_->phase == Phase::closed;
  };
  if (!state_->changed.wait_for(lock, of(timeout_s), told)) return too_long("reaching the target", timeout_s);
  if (found) return *found;
  return refused ? *refused : state_->ended;
}

std::optional<Placement> Session::placement(std::uint32_t target) const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  return state_->reached_book.find_placement(target);
}

Status Session::wait_frame(std::uint64_t frame, double timeout_s) {
  Status checked = check_wait(core_->events(), timeout_s);
  if (!checked) return checked;
  std::unique_lock<std::mutex> lock(state_->mutex);
  const auto there = [&] { return state_->gets_no_more() || state_->showable_to() > frame; };
  if (!state_->changed.wait_for(lock, of(timeout_s), there)) return too_long("the frame", timeout_s);
  return state_->showable_to() > frame ? Status() : state_->ended;
}

}  // namespace motiongen
