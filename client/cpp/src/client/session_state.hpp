// One character as the client knows it: its timeline, its book, and where it stands with the server.
#pragma once

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>

#include "client/book.hpp"
#include "client/events.hpp"
#include "client/outbox.hpp"
#include "client/reached.hpp"
#include "client/wire.hpp"
#include "motiongen/client/session.hpp"
#include "motiongen/core/frame_format.hpp"
#include "motiongen/v1/session.pb.h"

namespace motiongen {

// What a session does about its connection.
enum class Phase {
  waiting,  // for a stream: it was never opened, or its stream was lost
  opening,  // OpenSession is on its way: the first time, or again after a loss
  open,
  closing,  // CloseSession is on its way
  closed,
};

// `mutex` guards all of it; whoever calls a method holds it. Lock order: this, then those of Outbox and EventQueue.
class SessionState {
 public:
  // recovers: whether it goes on on another stream when its own is lost. backlog: as a book has it.
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
  Rig rig;  // set when it first opens, and never changed
  std::optional<Timeline> timeline;
  std::optional<FrameDecoder> decoder;  // of frames that are not stored as float32
  Opened opened;
  Status ended;  // why it is closed, or is closing
  SessionStats stats;
  double next_report_s = 0;
  double retry_at_s = 0;           // a refused reopening is tried again then
  std::optional<Outcome> refusal;  // of its opening for want of room, until it is known whether another server is asked
  bool can_report = false;         // it has reported on the present stream
  std::uint64_t last_seq = 0;      // the highest applied_seq
  bool is_durable = false;         // its server saves it, so that another can go on with it

  // ---- to the server

  // Put its OpenSession into the outbox: its first, one that resumes it where the server may have kept it, else one
  // that goes on from the frames held, with what was not answered. Where that is more than the server takes in a
  // message the session ends: the server would end the stream with all sessions.
  void send_open(Outbox& outbox, const Catalog& catalog, EventQueue& events);
  // What has it go on from a frame of its own: by number, or by the rows where the session at the server has another
  // count since it was opened anew.
  v1::SessionEvent seek_event(std::uint64_t frame, const Catalog& catalog) const;
  // Take an edit. Returns its number. One for frames before those of the session at the server is refused here; of one
  // that is so in part the rest is sent.
  EditId send_edit(v1::SessionEvent event, Outbox& outbox, EventQueue& events);
  void send_close(Outbox& outbox);
  // Whether its playhead shall move, from now on or from when it has opened.
  void set_playing(bool is_playing);
  // A report where it plays; moves the playhead to the present where the clock is the library's.
  void report(double now_s, double period_s, Outbox& outbox);

  // ---- frames

  // The first frame that may not be shown yet. Where a caller moves the playhead it goes as fast as the caller likes,
  // and the server puts an edit where nobody can be who plays in real time: until the edit is answered, only frames
  // that it cannot change are shown.
  std::uint64_t showable_to() const;
  // Clock::manual: show a frame. Once it has opened.
  Status advance_to(std::uint64_t frame);

  // ---- from the server. Where it broke a rule the session is closed, and the others go on

  void take_plan(const wire::Plan& plan, EventQueue& events, Outbox& outbox);
  void take_chunk(const wire::Chunk& chunk, EventQueue& events, Outbox& outbox);
  void take(const v1::SessionUpdate& update, const Catalog& catalog, double now_s, EventQueue& events, Outbox& outbox);

  // The stream is gone. It waits for another one, or ends with `status` where there will be none.
  void lose(const Status& status, bool will_reconnect, EventQueue& events);
  // It was closed here.
  void end_as_wished(EventQueue& events);
  void end(Status status, EventQueue& events);
  void end(Outcome outcome, EventQueue& events);

  // No other server is asked: it waits for this one where it was open before, else that is its end.
  void give_up_opening(EventQueue& events);

  // The answer to an edit, if it has come.
  std::optional<Outcome> find_answer(EditId edit) const;

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
  // Send them, or end where one of them is too big.
  void send_all(const std::vector<v1::SessionEvent>& said, Outbox& outbox, const Catalog& catalog, EventQueue& events);
  void set_level(const ServiceLevel& level, EventQueue& events);
  void serve_in_full(std::uint32_t denoise_steps, EventQueue& events);
  void take_outcome(const v1::EditOutcome& message, double now_s, EventQueue& events);
  void break_off(const Status& status, EventQueue& events, Outbox& outbox);
  void note_reached(const v1::ConstraintReached& message, EventQueue& events);
  // One about this session; what it tells is to be filled in.
  Event event_of(EventKind kind) const;
  void note_answer(EditId edit, Outcome outcome, EventQueue& events);
  void set_durable(bool is_kept, EventQueue& events);
  void open_anew(EventQueue& events);
  // Turns them into the timeline's frames.
  void shift_placements(std::vector<Placement>& placements) const;
  // What is known of the targets of an edit now that it is answered: by OK where it was taken.
  void settle_targets(const std::vector<std::uint32_t>& targets, const Status& answer);
  // The rows before `end`, as many as a window sees; none where they are not held. Returns how many.
  std::uint32_t prior_rows(const Catalog& catalog, std::uint64_t end, std::string& rows) const;
  void say_as_rows(v1::Seek& seek, const Catalog& catalog) const;

  static constexpr std::size_t kAnswersKept = 1024;

  std::uint64_t base_ = 0;  // the timeline's frame that is frame 0 of the present session on the server
  const bool recovers_;
  bool was_open_ = false;
  bool is_playing_ = true;  // as it was wished
  ServiceLevel level_;
  bool resuming_ = false;      // OpenSession with the token is on its way
  std::string token_;          // of the present session on the server; empty: it cannot be resumed
  std::uint32_t attempt_ = 0;  // to resume it
  std::deque<std::pair<EditId, Outcome>> answers_;
};

}  // namespace motiongen
