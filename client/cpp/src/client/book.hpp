// What a session was told: the changes not yet answered, and what the accepted ones left it with. From this a session
// is opened again after a loss, so that nothing that the server took is lost, and nothing it has not answered either.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "client/backlog.hpp"
#include "motiongen/client/types.hpp"
#include "motiongen/v1/session.pb.h"

namespace motiongen {

// How the server took an event. Frames are the timeline's.
struct Taken {
  std::uint64_t effective_frame = 0;
  std::vector<Placement> placements;
  std::uint64_t playhead = 0;  // then: what has ended by it is forgotten
};

class SessionBook {
 public:
  static constexpr std::uint32_t kPresentPrompt = 1;  // set without a frame; scheduled prompts have the ids above it

  // The first OpenSession, its prompts and constraints included. backlog: what waits for an answer counts there.
  SessionBook(std::uint32_t session, v1::OpenSession open, std::shared_ptr<Backlog> backlog = nullptr)
      : session_(session), open_(std::move(open)), backlog_(std::move(backlog)) {}

  // A constraint of the opening.
  void add_opening(v1::Constraint constraint) { *open_.add_constraints() = std::move(constraint); }

  std::uint32_t take_prompt_id() { return next_prompt_++; }
  std::uint32_t take_constraint_id() { return next_constraint_++; }

  // Whether an id was taken; that of the present prompt always is.
  bool knows_prompt(std::uint32_t id) const { return id >= kPresentPrompt && id < next_prompt_; }
  bool knows_constraint(std::uint32_t id) const { return id > 0 && id < next_constraint_; }

  // Scheduled prompts that hold no longer once another takes over, to be removed by the edit that says so: accepted
  // ones that have begun by the playhead, without the one that holds until then. One with an end goes by itself, and of
  // one that an edit on its way removes or replaces it is not known yet whether it is there.
  std::vector<std::uint32_t> begun_prompts(std::uint64_t playhead, bool spare_last) const;

  // Note an edit. Its frames are the timeline's. Returns its number; `event_seq` of the event is set.
  EditId add(v1::SessionEvent& event);
  // Note one that is never sent.
  EditId add_unsent() { return next_edit_++; }

  // ---- on the wire

  // A new stream: the events of the session count from 1 again.
  void begin_stream() { next_seq_ = 1; }
  std::uint64_t take_seq() { return next_seq_++; }

  // The message that opens the session for the first time, or anew where `prior` (rows of patch_frames each, the last
  // of which is shown before frame `base`) says what it did; without it, it starts at its start pose. Prompts in whose
  // place others come later are left out where there would be more than most_prompts.
  v1::OpenSession opening() const { return open_; }
  v1::OpenSession reopening(std::uint64_t base, std::uint32_t num_prior, std::string prior,
                            std::size_t most_prompts) const;

  // Every event up to this one has been answered.
  std::uint64_t answered_seq() const {
    return pending_.empty() ? next_seq_ - 1 : pending_.front().event.event_seq() - 1;
  }

  // Events that have no answer, as they were sent: what the server has taken of them it knows by their numbers.
  std::vector<v1::SessionEvent> repetitions(std::uint64_t base) const;

  // The same for a session that is opened anew: numbered anew and in order. What holds and its opening cannot say comes
  // first: a cut that has not come yet, the velocity, a pause.
  std::vector<v1::SessionEvent> unanswered(std::uint64_t base);

  // What an edit without an answer asked for at frames that a session which begins at `base` does not have.
  struct Passed {
    EditId edit = 0;
    std::vector<std::uint32_t> targets;
    bool is_all = false;  // nothing else is left of it
  };
  // All of these; edits of which nothing is left are not said again.
  std::vector<Passed> take_passed(std::uint64_t base);

  // Let `change` see every cut that is said again.
  template <class Change>
  void change_seeks(Change change) {
    for (Pending& each : pending_) {
      if (each.event.has_seek()) change(*each.event.mutable_seek());
    }
    if (cut_) change(*cut_->event.mutable_seek());
  }

  // The targets that an event without an answer sets.
  std::vector<std::uint32_t> targets_of(std::uint64_t event_seq) const;
  // Whether an event without an answer asks for a cut.
  bool is_cut(std::uint64_t event_seq) const;
  // Whether an event without an answer sets a target.
  bool is_being_set(std::uint32_t target) const;
  // Whether a target may be told of: it is on its way, or was accepted and is not over.
  bool expects(std::uint32_t target) const;
  // The targets of which nothing is left at a frame: a session that is opened anew there is not told of them.
  std::vector<std::uint32_t> passed_at(std::uint64_t frame) const;

  // The answer to the event with a number: which edit it was, 0 for one of ours; nothing where none waits. What was
  // accepted is kept. taken: nothing where it was refused.
  std::optional<EditId> answer(std::uint64_t event_seq, const std::optional<Taken>& taken);

  // The server has opened it: prompts and constraints of the opening hold.
  void opened(const std::vector<Placement>& placements);

  // It was opened anew as `reopening(base, ...)` says: what is left of its constraints is where the new session has put
  // it.
  void reopened(std::uint64_t base, const std::vector<Placement>& placements);

  // Frames before the first that a window sees, as they were asked for last; 0: the model's own.
  std::uint32_t history_frames() const { return open_.history_frames(); }

  // Constraints before a frame have been played and are not needed any more.
  void forget_before(std::uint64_t frame);

  // The server has told what became of a target: nothing is asked of it any more, met early or not.
  void end_target(std::uint32_t target);

  bool is_paused() const { return paused_; }

  // Whether anything that was said has no answer yet.
  bool is_waiting() const { return !pending_.empty(); }

  // The session has ended: what has no answer gets none.
  void drop_unanswered() { pending_.clear(); }

 private:
  struct Pending {
    EditId edit = 0;
    v1::SessionEvent event;
    BacklogShare share;
  };
  struct Held {
    v1::SessionEvent event;
    std::uint64_t frame = 0;  // a velocity's end, a cut's first
  };

  void accept(const v1::SessionEvent& event, const Taken& taken);
  void accept_options(const v1::SetOptions& options);
  void place(const std::vector<Placement>& placements);
  void accept_prompts(const v1::EditPrompts& edit, const Taken& taken);
  void put_prompt(v1::PromptSpan span, std::uint64_t playhead);
  std::vector<v1::PromptSpan> prompts_from(std::uint64_t base, std::size_t most) const;
  bool is_being_changed(std::uint32_t prompt_id) const;
  bool is_over(const v1::Constraint& constraint, std::uint64_t frame) const;
  std::optional<v1::Constraint> left(const v1::Constraint& constraint, std::uint64_t frame) const;

  std::uint32_t session_;
  v1::OpenSession open_;
  std::shared_ptr<Backlog> backlog_;
  std::uint64_t next_seq_ = 1;
  EditId next_edit_ = 1;
  std::uint32_t next_prompt_ = kPresentPrompt + 1;
  std::uint32_t next_constraint_ = 1;
  std::deque<Pending> pending_;
  std::vector<v1::PromptSpan> prompts_;      // in the order they were set
  std::vector<v1::Constraint> constraints_;  // in the order they were set: of equal ones the last holds
  std::map<std::uint32_t, Placement> placements_;
  std::optional<Held> velocity_;
  std::optional<Held> cut_;
  bool paused_ = false;
  bool opened_ = false;
};

}  // namespace motiongen
