// The state of one session: its timeline, its book, and its phase with the server.
#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <random>

#include "client/answers.hpp"
#include "client/backoff.hpp"
#include "client/book.hpp"
#include "client/events.hpp"
#include "client/outbox.hpp"
#include "client/reached.hpp"
#include "client/repeating.hpp"
#include "client/wire.hpp"
#include "motiongen/client/session.hpp"
#include "motiongen/core/frame_format.hpp"
#include "motiongen/v1/session.pb.h"

namespace motiongen {

// The phase of a session with the server.
enum class Phase {
  waiting,  // for a stream: it has not been opened yet, or its stream was lost
  opening,  // OpenSession was sent: for the first time, or again after a loss
  open,
  closing,  // CloseSession was sent
  closed,
};

// `mutex` guards all of it; callers of its methods hold it. Lock order: this one, then those of Outbox and EventQueue.
class SessionState {
 public:
  // recovers: whether the session continues on another stream if its own is lost. backlog: as for SessionBook.
  SessionState(std::uint32_t given_id, SessionOptions given, v1::OpenSession open, bool recovers,
               std::shared_ptr<Backlog> backlog = nullptr)
      : id(given_id),
        options(std::move(given)),
        book(given_id, std::move(open), std::move(backlog)),
        recovers_(recovers) {}

  mutable std::mutex mutex;
  std::condition_variable changed;

  const std::uint32_t id;
  const SessionOptions options;
  SessionBook book;
  ReachedBook reached_book;
  Phase phase = Phase::waiting;
  Rig rig;  // set when the session first opens, and never changed
  std::optional<Timeline> timeline;
  std::optional<FrameDecoder> decoder;  // for frames that are not sent as float32
  Opened opened;
  Status ended;  // why the session is closed, or is closing
  SessionStats stats;
  double next_report_s = 0;
  double retry_at_s = 0;           // when a refused opening is tried again, or a session that the server ended
  std::optional<Outcome> refusal;  // of its opening for lack of room, until it is decided whether to ask another server
  bool can_report = false;         // it has sent a report on the present stream
  std::uint64_t last_seq = 0;      // the highest applied_seq
  bool is_durable = false;         // the server saves it, so that another server can continue it

  // ---- to the server

  // Put OpenSession into the outbox: the first one; after a loss, one that resumes the session if the server may have
  // kept it; else one that continues from the frames held, followed by the unanswered events, as many as the server
  // takes at once. If one of these is bigger than the server accepts, the session ends, since the server would
  // otherwise end the stream and with it all sessions.
  void send_open(Outbox& outbox, const Catalog& catalog, EventQueue& events);
  // The event that continues from one of the session's own frames: by number, or by rows if the session was opened anew
  // after that frame, so that the server does not have it.
  v1::SessionEvent seek_event(std::uint64_t frame, const Catalog& catalog) const;
  // Take an edit and return its number. An edit for frames before the first of the server's session is refused here; if
  // only a part is, the rest is sent. While older ones are said again, it waits behind them.
  EditId send_edit(v1::SessionEvent event, Outbox& outbox, EventQueue& events);
  void send_close(Outbox& outbox);
  // Say the next of the unanswered events again, if they are due.
  void say_more(double now_s, Outbox& outbox);
  // Whether the playhead should move, from now on or once the session has opened.
  void set_playing(bool is_playing);
  // Report the playhead. If the clock is the library's, moves it to the present first.
  void report(double now_s, double period_s, Outbox& outbox);

  // ---- frames

  // The first frame that may not be shown yet. The server lets an edit take effect where a playhead in real time cannot
  // be yet, but a caller may move the playhead faster than that. So with a manual clock only frames that an edit cannot
  // change are shown until it is answered.
  std::uint64_t showable_to() const;
  // Clock::manual: show a frame. Only once the session has opened.
  Status advance_to(std::uint64_t frame);

  // ---- from the server. If it broke a rule, this session is closed and the others go on

  void take_plan(const wire::Plan& plan, EventQueue& events, Outbox& outbox);
  void take_chunk(const wire::Chunk& chunk, EventQueue& events, Outbox& outbox);
  void take(const v1::SessionUpdate& update, const Catalog& catalog, double now_s, EventQueue& events, Outbox& outbox);

  // The stream is lost. The session waits for another one, or ends with `status` if there will be none.
  void lose(const Status& status, bool will_reconnect, EventQueue& events);
  // End a session that was closed here.
  void end_as_wished(EventQueue& events);
  void end(Status status, EventQueue& events);
  void end(Outcome outcome, EventQueue& events);

  // No other server will be asked: a session that was open before waits for this one, any other ends.
  void give_up_opening(EventQueue& events);

  // Whether no frame will come any more.
  bool gets_no_more() const { return phase == Phase::closed || phase == Phase::closing; }

  // The answer to an edit, if it has arrived.
  std::optional<Outcome> find_answer(EditId edit) const { return answers_.find(edit); }

 private:
  void report_before_edit(Outbox& outbox);
  void take_opened(const v1::SessionOpened& message, const Catalog& catalog, EventQueue& events, Outbox& outbox);
  void take_resumed(const v1::SessionOpened& message, const Catalog& catalog, EventQueue& events, Outbox& outbox);
  void take_placements_anew();
  EditId refuse_unsent(const v1::SessionEvent& event, EventQueue& events);
  void refuse_passed(EditId edit, const std::vector<std::uint32_t>& targets, EventQueue& events);
  void leave_out(const std::vector<std::uint32_t>& targets);
  void settle_passed(EventQueue& events);
  Status begin(const Rig& of, std::uint64_t start_frame, const Catalog& catalog);
  void take_closed(const v1::SessionClosed& message, double now_s, EventQueue& events);
  v1::SessionEvent resuming_event();
  v1::SessionEvent opening_event(const Catalog& catalog);
  // Whether a server has the session, or is about to have it, so that it hears what is said now.
  bool is_heard() const;
  void say(const v1::SessionEvent& event, Outbox& outbox);
  // Say the unanswered events again: the first of them now, the others by and by. per_second: as for Repeating.
  void say_again(double per_second, Outbox& outbox);
  void say_next(std::size_t most, Outbox& outbox);
  // Whether the server accepts events of this size; if not, the session ends, which no server has.
  bool check_sizes(const std::vector<v1::SessionEvent>& said, const Catalog& catalog, EventQueue& events);
  // Drop the first unanswered event that is bigger than the server accepts, and all after it. Returns why, if so.
  Status drop_misfits(const Catalog& catalog);
  void set_level(const ServiceLevel& level, EventQueue& events);
  void serve_in_full(std::uint32_t denoise_steps, EventQueue& events);
  void take_outcome(const v1::EditOutcome& message, double now_s, EventQueue& events);
  void break_off(const Status& status, EventQueue& events, Outbox& outbox);
  void note_reached(const v1::ConstraintReached& message, EventQueue& events);
  // An event of this session, without its contents.
  Event event_of(EventKind kind) const;
  // The answer to the edits from `first` to `last`: all but the last were never said, since it took their place.
  void note_answer(EditId first, EditId last, Outcome outcome, EventQueue& events);
  void set_durable(bool is_kept, EventQueue& events);
  void open_anew(EventQueue& events);
  // asked_s: how long the server asked to wait; 0: it did not.
  void ask_again_later(double now_s, double asked_s);
  // Converts them to the timeline's frames.
  void shift_placements(std::vector<Placement>& placements) const;
  // Settle what is known of an edit's targets, now that it is answered. answer: OK if it was accepted.
  void settle_targets(const std::vector<std::uint32_t>& targets, const Status& answer);
  // The rows before `end`, as many as a window sees and as fit in an event beside rest_bytes of other contents. Returns
  // how many; none if they are not held.
  std::uint32_t prior_rows(const Catalog& catalog, std::uint64_t end, std::uint64_t rest_bytes,
                           std::string& rows) const;
  void say_as_rows(v1::Seek& seek, const Catalog& catalog) const;

  std::uint64_t base_ = 0;  // the timeline's frame that is frame 0 of the present session on the server
  const bool recovers_;
  bool was_open_ = false;
  bool is_playing_ = true;  // as the caller wants it
  ServiceLevel level_;
  bool resuming_ = false;      // OpenSession with the token was sent
  std::string token_;          // of the present session on the server; empty: it cannot be resumed
  std::uint32_t attempt_ = 0;  // the number of the last attempt to resume it
  Backoff backoff_;            // of its openings
  std::minstd_rand random_{std::random_device{}()};
  Repeating repeating_;
  std::uint64_t said_to_ = 0;  // the highest event number that the present session on the server may have received
  AnswerBook answers_;
};

}  // namespace motiongen
