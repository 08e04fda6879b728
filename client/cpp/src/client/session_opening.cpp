// How a session begins: for the first time, resumed, or anew from the frames held; and how it or its stream ends.
#include <algorithm>

#include "client/convert.hpp"
#include "client/frame_shift.hpp"
#include "client/session_state.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostTokenBytes = 4096;      // of a session's token; those of our server have less than 100
constexpr std::uint32_t kMostLookahead = 1 << 16;  // frames; servers grant 10,000 at most
constexpr std::uint64_t kAroundRowsBytes = 64;     // tags, lengths and numbers of the messages around rows

bool same_rows(const Rig& a, const Rig& b) {
  return a.row_width == b.row_width && a.joint_names == b.joint_names && a.frame_rate_hz == b.frame_rate_hz &&
         a.rotation_column == b.rotation_column && a.root_column == b.root_column && a.offsets_m == b.offsets_m;
}

Status passed() {
  return {Code::failed_precondition, "FRAME_COMMITTED", "its frames passed while the connection was lost"};
}

}  // namespace

std::uint32_t SessionState::prior_rows(const Catalog& catalog, std::uint64_t end, std::uint64_t rest_bytes,
                                       std::string& rows) const {
  const Model* model = convert::find_model(catalog, opened.model_id);
  if (!timeline || model == nullptr || end <= timeline->first_kept() || end > timeline->buffered_to()) return 0;
  const std::uint64_t patch = std::max<std::uint64_t>(model->patch_frames, 1);
  const std::uint64_t asked = book.history_frames() != 0 ? book.history_frames() : model->default_history_frames;
  // as many as a window sees and as fit into a message; one patch in any case, since without any it would jump
  const std::uint64_t patch_bytes = patch * rig.own_width * sizeof(float);
  const std::uint64_t event_bytes = Outbox::most_event_bytes(catalog.limits.max_request_bytes);
  const std::uint64_t room_bytes = event_bytes - std::min(rest_bytes + kAroundRowsBytes, event_bytes);
  const std::uint64_t most = std::max(room_bytes / patch_bytes, std::min<std::uint64_t>(event_bytes / patch_bytes, 1));
  const std::uint64_t wanted = std::min(std::max<std::uint64_t>(asked / patch, 1), most) * patch;
  if (wanted == 0) return 0;
  std::uint64_t first = std::max(timeline->first_kept(), end < wanted ? 0 : end - wanted);
  const auto cut = timeline->cut_before(end);  // frames before the cut are from another place
  if (cut) first = std::max(first, *cut);
  const auto put = [&](std::uint64_t frame) {
    const auto row = timeline->row(frame);
    rows.append(reinterpret_cast<const char*>(row.value().data()), rig.own_width * sizeof(float));
  };
  for (std::uint64_t missing = wanted - (end - first); missing > 0; --missing) put(first);
  for (std::uint64_t frame = first; frame < end; ++frame) put(frame);
  return static_cast<std::uint32_t>(wanted);
}

v1::SessionEvent SessionState::seek_event(std::uint64_t frame, const Catalog& catalog) const {
  v1::SessionEvent event;
  event.mutable_seek()->set_frame(frame);
  say_as_rows(*event.mutable_seek(), catalog);
  return event;
}

void SessionState::say_as_rows(v1::Seek& seek, const Catalog& catalog) const {
  if (seek.frame() == 0 || seek.frame() > base_) return;
  std::string rows;
  const std::uint32_t num_rows = prior_rows(catalog, seek.frame(), 0, rows);
  if (num_rows == 0) return;
  auto* frames = seek.mutable_prior_frames();
  frames->set_frame_count(num_rows);
  frames->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
  frames->set_data(std::move(rows));
  seek.clear_frame();
}

v1::SessionEvent SessionState::resuming_event() {
  v1::SessionEvent event;
  event.set_session(id);
  event.set_event_seq(1);
  event.mutable_open()->set_resume_token(token_);
  auto* point = event.mutable_open()->mutable_resume_point();
  point->set_next_frame(timeline->received_to() - base_);
  point->set_plan(timeline->plan());
  point->set_answered_seq(book.answered_seq());
  point->set_attempt(++attempt_);
  // for another server, which may not know these
  point->set_playhead(timeline->playhead() > base_ ? timeline->playhead() - base_ : 0);
  point->set_committed_to(timeline->committed_to() > base_ ? timeline->committed_to() - base_ : 0);
  return event;
}

void SessionState::send_open(Outbox& outbox, const Catalog& catalog, EventQueue& events) {
  can_report = false;
  resuming_ = was_open_ && !token_.empty();
  phase = Phase::opening;
  repeating_.stop();
  if (resuming_) {
    const v1::SessionEvent resuming = resuming_event();
    if (check_sizes({resuming}, catalog, events)) outbox.put(resuming);
    return;
  }
  std::vector<v1::SessionEvent> said = {opening_event(catalog)};
  settle_passed(events);
  for (v1::SessionEvent& each : book.unanswered(base_)) said.push_back(std::move(each));
  said_to_ = 0;
  if (!check_sizes(said, catalog, events)) return;
  say(said.front(), outbox);
  say_again(static_cast<double>(catalog.limits.max_events_per_second), outbox);
}

// Sent again, edits that have passed would take effect at the first frame of the new session.
void SessionState::settle_passed(EventQueue& events) {
  for (const SessionBook::Passed& each : book.take_passed(base_)) {
    if (each.is_all) {
      refuse_passed(each.edit, each.targets, events);
    } else {
      leave_out(each.targets);
    }
  }
}

// The targets that have passed, of an edit whose other part is sent.
void SessionState::leave_out(const std::vector<std::uint32_t>& targets) {
  for (const std::uint32_t target : targets) reached_book.refuse(target, passed());
  if (!targets.empty()) changed.notify_all();
}

EditId SessionState::refuse_unsent(const v1::SessionEvent& event, EventQueue& events) {
  const EditId edit = book.add_unsent();
  refuse_passed(edit, targets_of(event), events);
  return edit;
}

void SessionState::refuse_passed(EditId edit, const std::vector<std::uint32_t>& targets, EventQueue& events) {
  settle_targets(targets, passed());
  Outcome outcome;
  outcome.status = passed();
  note_answer(edit, edit, std::move(outcome), events);
  changed.notify_all();
}

v1::SessionEvent SessionState::opening_event(const Catalog& catalog) {
  book.begin_stream();
  last_seq = 0;
  v1::SessionEvent event;
  event.set_session(id);
  event.set_event_seq(book.take_seq());
  if (was_open_) {
    std::string rows;
    base_ = timeline->buffered_to();
    v1::OpenSession rest = book.reopening(base_, 0, "", catalog.limits.max_prompts);
    rest.clear_prior_frames();  // those of the first opening, in whose place come the rows
    rest.set_model_id(opened.model_id);
    rest.set_seed(opened.seed);
    const std::uint32_t num_rows = prior_rows(catalog, base_, rest.ByteSizeLong(), rows);
    book.change_seeks([&](v1::Seek& seek) { say_as_rows(seek, catalog); });
    *event.mutable_open() = book.reopening(base_, num_rows, std::move(rows), catalog.limits.max_prompts);
    event.mutable_open()->set_model_id(opened.model_id);
    event.mutable_open()->set_seed(opened.seed);
  } else {
    *event.mutable_open() = book.opening();
  }
  return event;
}

void SessionState::take_closed(const v1::SessionClosed& message, double now_s, EventQueue& events) {
  if (message.reason() == v1::CLOSE_REASON_CLIENT) return end_as_wished(events);
  const Status why = convert::closed(message);
  const bool gone_on_with = message.reason() == v1::CLOSE_REASON_DRAINED || why.code() == Code::unavailable;
  if (!gone_on_with || !recovers_ || !was_open_ || phase == Phase::closing) return end(why, events);
  // if it is durable, it can be resumed at another server, or at this one if only the model was lost
  if (!is_durable) open_anew(events);
  ask_again_later(now_s, 0);
}

void SessionState::ask_again_later(double now_s, double asked_s) {
  phase = Phase::waiting;
  const double wait_s = backoff_.next_s(now_s) * Backoff::jitter(random_);
  retry_at_s = now_s + std::max(wait_s, Backoff::bounded_s(asked_s));
}

void SessionState::open_anew(EventQueue& events) {
  token_.clear();
  set_durable(false, events);
  phase = Phase::waiting;
}

void SessionState::take_resumed(const v1::SessionOpened& message, const Catalog& catalog, EventQueue& events,
                                Outbox& outbox) {
  resuming_ = false;
  token_ = message.session_token();
  // the close takes the number of the first event that this server would not accept, or it would be refused as a gap
  const Status fit = drop_misfits(catalog);
  if (phase == Phase::closing) {  // the close is numbered after the unanswered events
    say_again(0, outbox);
    return send_close(outbox);
  }
  phase = Phase::open;
  ++stats.recoveries;
  reached_book.begin_replay();
  Event event = event_of(EventKind::recovered);
  event.frame = base_ + message.start_frame();
  event.exact = true;
  events.push(std::move(event));
  serve_in_full(message.denoise_steps(), events);
  report_before_edit(outbox);  // the playhead may have moved meanwhile
  say_again(fit ? static_cast<double>(catalog.limits.max_events_per_second) : 0, outbox);
  if (!fit) break_off(fit, events, outbox);
}

void SessionState::take_opened(const v1::SessionOpened& message, const Catalog& catalog, EventQueue& events,
                               Outbox& outbox) {
  if (phase == Phase::open) {
    return break_off(violation("a session was opened that had not been asked for"), events, outbox);
  }
  const bool is_closing = phase == Phase::closing && resuming_;
  if (phase != Phase::opening && !is_closing) return;
  if (message.session_token().size() > kMostTokenBytes) {
    return break_off(
        violation("a session was opened with a token of " + std::to_string(message.session_token().size()) +
                  " bytes; at most " + std::to_string(kMostTokenBytes) + " can be"),
        events, outbox);
  }
  if (resuming_) return take_resumed(message, catalog, events, outbox);
  const auto found = convert::session_rig(catalog, message, options.outputs);
  if (!found) return break_off(found.status(), events, outbox);
  opened = convert::opened(message);
  shift_placements(opened.placements);
  for (const Placement& each : opened.placements) reached_book.note(each);
  token_ = message.session_token();
  attempt_ = 0;
  phase = Phase::open;
  reached_book.end_replay();
  const bool was_reopened = was_open_;
  Event event = event_of(was_reopened ? EventKind::recovered : EventKind::opened);
  event.outcome.warnings = opened.warnings;
  if (was_reopened) {
    if (!same_rows(rig, found.value())) {
      return break_off(Status(Code::failed_precondition, "RIG_CHANGED", "the server came back with another rig"),
                       events, outbox);
    }
    timeline->continue_with_new_plans();
    ++stats.recoveries;
    event.frame = base_;
    take_placements_anew();
  } else {
    const Status begun = begin(found.value(), message.start_frame(), catalog);
    if (!begun) return break_off(begun, events, outbox);
  }
  events.push(std::move(event));
  // for a session that has just opened, no other level has been reported
  if (!was_reopened) level_ = {v1::SERVICE_TIER_FULL, opened.denoise_steps};
  serve_in_full(opened.denoise_steps, events);
}

// A session opens and resumes at the full level; if that does not hold, the server sends another level.
void SessionState::serve_in_full(std::uint32_t denoise_steps, EventQueue& events) {
  const ServiceLevel full = {v1::SERVICE_TIER_FULL, denoise_steps};
  if (level_.tier != full.tier || level_.denoise_steps != full.denoise_steps) set_level(full, events);
}

// Ends the waits for targets that the new session is not told of: no result will come for them.
void SessionState::take_placements_anew() {
  for (const std::uint32_t target : book.passed_at(base_)) {
    if (!book.is_being_set(target)) reached_book.refuse(target, passed());
  }
  book.reopened(base_, opened.placements);
}

Status SessionState::begin(const Rig& of, std::uint64_t start_frame, const Catalog& catalog) {
  TimelineOptions made;
  made.frame_rate_hz = of.frame_rate_hz;
  made.row_width = of.row_width;
  made.start_frame = start_frame;
  made.keep_frames = options.keep_frames;
  const Model* model = convert::find_model(catalog, opened.model_id);
  if (opened.lookahead_frames > kMostLookahead) {
    return violation("a session was opened with a lookahead of " + std::to_string(opened.lookahead_frames) +
                     " frames; at most " + std::to_string(kMostLookahead) + " can be");
  }
  const std::uint32_t horizon = model != nullptr ? std::min(model->horizon_frames, kMostLookahead) : 0;
  made.reserve_frames = 2 * opened.lookahead_frames + horizon;
  auto timeline_made = Timeline::make(made);
  if (!timeline_made) return timeline_made.status();
  rig = of;
  timeline.emplace(std::move(timeline_made).value());
  if (options.frame_format != FrameFormat::f32) decoder.emplace(rig, options.frame_format);
  if (!is_playing_) timeline->pause();
  book.opened(opened.placements);
  was_open_ = true;
  return {};
}

void SessionState::lose(const Status& status, bool will_reconnect, EventQueue& events) {
  if (phase == Phase::closed) return;
  if (phase == Phase::closing) return end_as_wished(events);
  if (!will_reconnect) return end(status, events);
  phase = Phase::waiting;
  retry_at_s = 0;
  can_report = false;
  changed.notify_all();
}

}  // namespace motiongen
