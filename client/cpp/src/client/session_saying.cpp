// What a session says to the server: edits, reports of the playhead, and again what has no answer.
#include <algorithm>

#include "client/convert.hpp"
#include "client/frame_shift.hpp"
#include "client/session_state.hpp"

namespace motiongen {

EditId SessionState::send_edit(v1::SessionEvent event, Outbox& outbox, EventQueue& events) {
  event.set_session(id);
  auto said = shifted(event, base_);
  if (!said) return refuse_unsent(event, events);
  leave_out(passed_targets_of(event, base_));
  const bool can_say = is_heard() && !repeating_.is_under_way();
  if (can_say) report_before_edit(outbox);
  if (event.has_set_play_state()) set_playing(event.set_play_state().state() == v1::PLAY_STATE_PLAYING);
  if (const auto overtaking = book.overtake(event, said_to_)) return *overtaking;
  const EditId edit = book.add(event);
  said->set_event_seq(event.event_seq());
  if (can_say) say(*said, outbox);
  return edit;
}

bool SessionState::is_heard() const { return phase == Phase::open || (phase == Phase::opening && !resuming_); }

void SessionState::say(const v1::SessionEvent& event, Outbox& outbox) {
  said_to_ = std::max<std::uint64_t>(said_to_, event.event_seq());
  outbox.put(event);
}

bool SessionState::check_sizes(const std::vector<v1::SessionEvent>& said, const Catalog& catalog, EventQueue& events) {
  for (const v1::SessionEvent& each : said) {
    Status fits = convert::check_size(each.has_open() ? "the session" : "edit", each, catalog.limits);
    if (fits) continue;
    end(std::move(fits), events);
    return false;
  }
  return true;
}

Status SessionState::drop_misfits(const Catalog& catalog) {
  for (const v1::SessionEvent& each : book.repetitions(base_)) {
    Status fits = convert::check_size("edit", each, catalog.limits);
    if (fits) continue;
    book.drop_from(each.event_seq());
    return fits;
  }
  return {};
}

void SessionState::say_again(double per_second, Outbox& outbox) { say_next(repeating_.begin(per_second), outbox); }

void SessionState::say_next(std::size_t most, Outbox& outbox) {
  const auto next = book.repetitions(base_, repeating_.next_seq(), most);
  for (const v1::SessionEvent& each : next) say(each, outbox);
  if (next.size() < most || next.back().event_seq() >= book.newest_seq()) return repeating_.stop();
  repeating_.go_on_from(next.back().event_seq() + 1);
}

void SessionState::say_more(double now_s, Outbox& outbox) {
  if (!is_heard() || !repeating_.is_under_way()) return;
  const std::size_t part = repeating_.part_due(now_s);
  if (part == 0) return;
  report_before_edit(outbox);
  say_next(part, outbox);
}

void SessionState::report_before_edit(Outbox& outbox) {
  // If the caller moves the playhead, the server cannot estimate it, so it is told before it chooses what to change.
  if (options.clock != Clock::manual) return;
  // The regular reports keep their times: another report after each edit would use up the session's rate limit.
  const double regular_s = next_report_s;
  report(0, 0, outbox);
  next_report_s = regular_s;
}

void SessionState::set_playing(bool is_playing) {
  is_playing_ = is_playing;
  if (timeline) is_playing ? timeline->resume() : timeline->pause();
}

void SessionState::report(double now_s, double period_s, Outbox& outbox) {
  if (phase != Phase::open || !timeline) return;
  if (options.clock == Clock::real_time) timeline->advance(now_s);
  if (outbox.is_full()) return;  // the next report says it all
  // Not reported while playback has not reached the frames of a session opened anew, since the server would count on
  // from there. But a playhead that stands still is reported, or the session would be closed as idle, and so is one
  // that was reported before on this stream.
  const bool stands = !timeline->started() || !timeline->playing();
  if (!stands && !can_report && timeline->playhead() < base_) return;
  std::string entry;
  wire::put_playhead(id, std::max(timeline->playhead(), base_) - base_, timeline->buffered_to() - base_,
                     timeline->underruns(), book.answered_seq(), entry);
  outbox.put(entry);
  // sessions that open together report at different times of the period, so that the server does not get all at once
  next_report_s = now_s + (can_report ? period_s : period_s * (1 + id % 10) / 10);
  can_report = true;
}

}  // namespace motiongen
