#include "client/session_state.hpp"

#include <algorithm>
#include <limits>

#include "client/convert.hpp"

namespace motiongen {
namespace {

constexpr double kMovingS = 1;  // the time for the client to go to another server, before this one is asked again

Status closed_here() { return {Code::cancelled, "CLIENT", "the session was closed here"}; }

// The highest frame in an update.
std::uint64_t highest_frame(const v1::SessionUpdate& update) {
  std::uint64_t highest = std::max(
      {update.opened().start_frame(), update.outcome().effective_frame(), update.constraint_reached().frame()});
  for (const auto* placements : {&update.opened().placements(), &update.outcome().placements()}) {
    for (const v1::ConstraintPlacement& each : *placements) {
      highest = std::max({highest, each.first_frame(), each.last_frame(), each.arrival_frame(), each.anchor_frame()});
    }
  }
  return highest;
}

}  // namespace

// ---- to the server

void SessionState::send_close(Outbox& outbox) {
  phase = Phase::closing;
  ended = closed_here();
  if (resuming_) return;  // the close follows the unanswered events, which are sent once the session is resumed
  if (repeating_.is_under_way()) say_next(Repeating::kAll, outbox);  // whatever becomes of them: it follows them
  v1::SessionEvent event;
  event.set_session(id);
  event.set_event_seq(book.take_seq());
  event.mutable_close();
  outbox.put(event);
}

// ---- frames

std::uint64_t SessionState::showable_to() const {
  if (!timeline) return 0;
  const std::uint64_t held_to = timeline->buffered_to();
  const bool may_change = options.clock == Clock::manual && phase == Phase::open && book.is_waiting();
  if (!may_change) return held_to;
  const std::uint64_t shown_to = timeline->started() ? timeline->playhead() + 1 : 0;
  return std::max(shown_to, std::min(timeline->committed_to(), held_to));
}

Status SessionState::advance_to(std::uint64_t frame) {
  if (frame >= showable_to() && frame < timeline->buffered_to()) {
    return {Code::out_of_range, "EDIT_UNANSWERED",
            "frame: " + std::to_string(frame) + " was given; an edit that has no answer yet may change frames from " +
                std::to_string(showable_to()) + " on"};
  }
  const bool began = !timeline->started();
  const auto reached = timeline->advance_to(frame);
  if (!reached) return reached.status();
  // nothing is left to show: ask for more frames with the next report, at once
  if (began || frame + 1 == showable_to()) next_report_s = 0;
  return {};
}

// ---- from the server

void SessionState::take_plan(const wire::Plan& plan, EventQueue& events, Outbox& outbox) {
  if (phase != Phase::open || !timeline) return;  // sent before the server knew that the session had ended here
  const Status taken = timeline->announce_plan(plan.plan, plan.valid_from + base_, plan.is_cut);
  if (!taken) return break_off(taken, events, outbox);
  ++stats.plans;
}

void SessionState::take_chunk(const wire::Chunk& chunk, EventQueue& events, Outbox& outbox) {
  if (phase != Phase::open || !timeline) return;
  reached_book.end_replay();
  if (chunk.scalar_type != static_cast<std::uint64_t>(options.frame_format)) {
    return break_off(violation("a chunk has scalar type " + std::to_string(chunk.scalar_type) + "; " +
                               std::to_string(static_cast<std::uint64_t>(options.frame_format)) + " was asked for"),
                     events, outbox);
  }
  ChunkHeader header = chunk.header;
  header.first_frame += base_;
  header.committed_to += base_;
  wire::ChunkRows stored(chunk.data);
  Status taken;
  if (decoder) {
    const auto before = timeline->row(header.first_frame - 1);
    taken = decoder->begin(stored, header.num_frames, {chunk.origin_m, chunk.num_origin},
                           before ? before.value() : Span<const float>());
  }
  if (taken) taken = timeline->add_chunk(header, decoder ? static_cast<RowSource&>(*decoder) : stored);
  if (!taken) return break_off(taken, events, outbox);
  stats.frames += header.num_frames;
  backoff_.note_frames();
  changed.notify_all();
}

void SessionState::take(const v1::SessionUpdate& update, const Catalog& catalog, double now_s, EventQueue& events,
                        Outbox& outbox) {
  if (phase == Phase::closed || phase == Phase::waiting) return;
  const std::uint64_t frame = highest_frame(update);
  if (frame > kLastFrame) {
    return break_off(violation("frame " + std::to_string(frame) + " is out of range; frames are numbered up to " +
                               std::to_string(kLastFrame)),
                     events, outbox);
  }
  const Status fits = convert::check_placements(update.opened().placements_size() + update.outcome().placements_size());
  if (!fits) return break_off(fits, events, outbox);
  last_seq = std::max<std::uint64_t>(last_seq, update.applied_seq());
  if (update.has_opened()) {
    take_opened(update.opened(), catalog, events, outbox);
  } else if (update.has_outcome()) {
    take_outcome(update.outcome(), now_s, events);
  } else if (update.has_service_level()) {
    set_level({static_cast<std::uint32_t>(update.service_level().tier()), update.service_level().denoise_steps()},
              events);
  } else if (update.has_durability()) {
    set_durable(update.durability().is_kept(), events);
  } else if (update.has_constraint_reached()) {
    note_reached(update.constraint_reached(), events);
  } else if (update.has_closed()) {
    take_closed(update.closed(), now_s, events);
  }
  changed.notify_all();
}

void SessionState::take_outcome(const v1::EditOutcome& message, double now_s, EventQueue& events) {
  Outcome outcome = convert::outcome(message);
  if (outcome.effective_frame) *outcome.effective_frame += base_;
  shift_placements(outcome.placements);
  if (message.event_seq() == 1) {
    if (outcome.status.ok()) return;
    if (phase == Phase::closing) return end_as_wished(events);  // nothing else will come: there is no session to close
    if (phase != Phase::opening) return;
    const Code code = outcome.status.code();
    if (resuming_ && code != Code::unavailable && code != Code::resource_exhausted) {
      open_anew(events);  // the server has not kept it
      retry_at_s = 0;     // with the next tick
      return;
    }
    const bool has_no_room = code == Code::unavailable || code == Code::resource_exhausted;
    if (!was_open_ && recovers_ && outcome.status.reason() == "DRAINING") {
      phase = Phase::waiting;  // this stream ends soon; ask on the next one
      retry_at_s = std::numeric_limits<double>::infinity();
      return;
    }
    if (!has_no_room || (!was_open_ && outcome.other_servers.empty())) return end(std::move(outcome), events);
    ask_again_later(now_s, outcome.retry_after_s.value_or(outcome.other_servers.empty() ? 0 : kMovingS));
    refusal = std::move(outcome);
    return;
  }
  // The answer crossed the session's end: events without an answer by then are sent again where the session continues.
  if (phase == Phase::opening && was_open_) return;
  std::optional<Taken> taken;
  if (outcome.status) {
    const std::uint64_t playhead = timeline ? timeline->playhead() : 0;
    taken = Taken{outcome.effective_frame.value_or(playhead), outcome.placements, playhead};
  }
  if (taken && timeline && outcome.effective_frame && book.is_cut(message.event_seq())) {
    taken->effective_frame = timeline->note_cut(*outcome.effective_frame);
  }
  const std::vector<std::uint32_t> targets = book.targets_of(message.event_seq());
  if (taken) {
    for (const std::uint32_t each : targets) reached_book.take_over(each, outcome.effective_frame.value_or(0));
  }
  const EditId num_others = book.num_overtaken(message.event_seq());
  const auto edit = book.answer(message.event_seq(), taken);
  settle_targets(targets, outcome.status);
  if (!edit || *edit == 0) return;
  for (const Placement& each : outcome.placements) reached_book.note(each);
  if (timeline) book.forget_before(timeline->first_kept());
  note_answer(*edit - num_others, *edit, std::move(outcome), events);
}

void SessionState::give_up_opening(EventQueue& events) {
  // if its retry time came meanwhile, the session was asked for again, and only the answer to that counts
  if (!was_open_ && phase == Phase::waiting) end(std::move(*refusal), events);
}

Event SessionState::event_of(EventKind kind) const {
  Event event;
  event.kind = kind;
  event.session = id;
  return event;
}

void SessionState::note_answer(EditId first, EditId last, Outcome outcome, EventQueue& events) {
  Event event = event_of(EventKind::edit);
  event.outcome = outcome;
  answers_.note(first, last, std::move(outcome));
  for (event.edit = first; event.edit <= last; ++event.edit) events.push(event);
}

void SessionState::note_reached(const v1::ConstraintReached& message, EventQueue& events) {
  Event event = event_of(EventKind::reached);
  event.reached = convert::reached(message);
  event.reached.frame += base_;
  // to a session that resumes, what became of its targets is told behind the answers, replacements' too
  const std::uint32_t target = event.reached.target;
  const bool is_former = book.excludes(target, event.reached.frame, reached_book.took_over_from(target));
  if (!reached_book.note(event.reached, is_former)) return;
  if (!is_former) book.end_target(event.reached.target);
  events.push(std::move(event));
}

void SessionState::set_durable(bool is_kept, EventQueue& events) {
  if (is_kept == is_durable) return;
  is_durable = is_kept;
  Event event = event_of(EventKind::durability);
  event.is_durable = is_kept;
  events.push(std::move(event));
}

void SessionState::set_level(const ServiceLevel& level, EventQueue& events) {
  level_ = level;
  Event event = event_of(EventKind::service_level);
  event.level = level;
  events.push(std::move(event));
}

void SessionState::shift_placements(std::vector<Placement>& placements) const {
  for (Placement& each : placements) {
    each.first_frame += base_;
    each.last_frame += base_;
    each.arrival_frame += base_;
    each.anchor_frame += base_;
  }
}

void SessionState::settle_targets(const std::vector<std::uint32_t>& targets, const Status& answer) {
  for (const std::uint32_t target : targets) {
    const bool was_taken = answer.ok();
    const bool is_last = !book.is_being_set(target);
    if (!was_taken && !is_last) continue;  // what applies is known once the other edit is answered
    reached_book.settle(target, was_taken, is_last);
    if (!was_taken && !book.expects(target)) reached_book.refuse(target, answer);
  }
}

void SessionState::break_off(const Status& status, EventQueue& events, Outbox& outbox) {
  send_close(outbox);
  phase = Phase::open;  // the application did not ask for this end, so it gets the event
  end(status, events);
}

void SessionState::end_as_wished(EventQueue& events) { end(closed_here(), events); }

void SessionState::end(Status status, EventQueue& events) {
  Outcome outcome;
  outcome.status = std::move(status);
  end(std::move(outcome), events);
}

void SessionState::end(Outcome outcome, EventQueue& events) {
  if (phase == Phase::closed) return;
  const bool told = phase != Phase::closing;
  phase = Phase::closed;
  ended = outcome.status;
  book.drop_unanswered();
  if (told) {
    Event event = event_of(EventKind::closed);
    event.outcome = std::move(outcome);
    events.push(std::move(event));
  }
  changed.notify_all();
}

}  // namespace motiongen
