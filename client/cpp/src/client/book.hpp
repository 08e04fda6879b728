// What a session was told: the edits not yet answered, and the state that the accepted ones add up to. After a loss the
// session is opened again from this, so that no edit is lost, whether it was accepted or not yet answered.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "client/backlog.hpp"
#include "motiongen/client/types.hpp"
#include "motiongen/v1/session.pb.h"

namespace motiongen {

// How the server accepted an event. Frames are the timeline's.
struct Taken {
  std::uint64_t effective_frame = 0;
  std::vector<Placement> placements;
  std::uint64_t playhead = 0;  // at that time: what has ended by it is forgotten
};

class SessionBook {
 public:
  static constexpr std::uint32_t kPresentPrompt = 1;  // set without a frame; scheduled prompts have higher ids

  // open: the first OpenSession, including prompts and constraints. backlog: counts what waits for an answer.
  SessionBook(std::uint32_t session, v1::OpenSession open, std::shared_ptr<Backlog> backlog = nullptr)
      : session_(session), open_(std::move(open)), backlog_(std::move(backlog)) {}

  // Add a constraint to the opening.
  void add_opening(v1::Constraint constraint) { *open_.add_constraints() = std::move(constraint); }

  std::uint32_t take_prompt_id() { return next_prompt_++; }
  std::uint32_t take_constraint_id() { return next_constraint_++; }

  // Whether an id was given out; the present prompt's always is.
  bool knows_prompt(std::uint32_t id) const { return id >= kPresentPrompt && id < next_prompt_; }
  bool knows_constraint(std::uint32_t id) const { return id > 0 && id < next_constraint_; }

  // Scheduled prompts that the edit which lets another take over must remove: accepted ones that have begun by the
  // playhead. spare_last: except the one that is in force until then. Prompts with an end are left out, since they end
  // by themselves, and so are those that an unanswered edit removes or replaces, since they may be gone already.
  std::vector<std::uint32_t> begun_prompts(std::uint64_t playhead, bool spare_last) const;

  // Add an edit, with frames of the timeline. Returns its number and sets the event's `event_seq`.
  EditId add(v1::SessionEvent& event);
  // If both this edit and the newest are velocities, and the newest has a number above `said_to`, so that no server has
  // received it: put this one in its place. Returns the number of the edit, or nothing if it has to be added.
  std::optional<EditId> overtake(const v1::SessionEvent& event, std::uint64_t said_to);
  // Number an edit that is never sent.
  EditId add_unsent() { return next_edit_++; }

  // ---- on the wire

  // A new session on the server: its events count from 1 again.
  void begin_stream() { next_seq_ = 1; }
  std::uint64_t take_seq() { return next_seq_++; }

  // The message that opens the session for the first time, or anew at the timeline's frame `base`. prior: num_prior
  // rows, whole patches, of the frames just before `base`; without them the session starts at its start pose. If there
  // would be more than most_prompts prompts, those that are replaced later are left out.
  v1::OpenSession opening() const { return open_; }
  v1::OpenSession reopening(std::uint64_t base, std::uint32_t num_prior, std::string prior,
                            std::size_t most_prompts) const;

  // All events up to this number have been answered.
  std::uint64_t answered_seq() const {
    return pending_.empty() ? next_seq_ - 1 : pending_.front().event.event_seq() - 1;
  }

  // The events without an answer, as they were sent, to be repeated: at most `most`, from the number `first_seq` on.
  // The server recognises by their numbers those that it has received.
  std::vector<v1::SessionEvent> repetitions(std::uint64_t base, std::uint64_t first_seq = 0,
                                            std::size_t most = std::numeric_limits<std::size_t>::max()) const;

  // Drop the unanswered events from this number on, which the server has not received; the next event gets the number.
  void drop_from(std::uint64_t event_seq);

  // The number of the newest event without an answer; 0 if there is none.
  std::uint64_t newest_seq() const { return pending_.empty() ? 0 : pending_.back().event.event_seq(); }

  // The same for a session that is opened anew: renumbered in order. The state that an opening cannot express comes
  // first: a cut that has not been played yet, the velocity, a pause.
  std::vector<v1::SessionEvent> unanswered(std::uint64_t base);

  // The part of an unanswered edit that asked for frames before those of a session that begins at `base`.
  struct Passed {
    EditId edit = 0;
    std::vector<std::uint32_t> targets;
    bool is_all = false;  // nothing else is left of the edit
  };
  // Take all of these; edits of which nothing is left are not sent again.
  std::vector<Passed> take_passed(std::uint64_t base);

  // Calls `change` on every cut that is sent again.
  template <class Change>
  void change_seeks(Change change) {
    for (Pending& each : pending_) {
      if (each.event.has_seek()) change(*each.event.mutable_seek());
    }
    if (cut_) change(*cut_->event.mutable_seek());
  }

  // The targets that an unanswered event sets.
  std::vector<std::uint32_t> targets_of(std::uint64_t event_seq) const;
  // How many edits, those numbered just before its own, an unanswered event has taken the place of.
  EditId num_overtaken(std::uint64_t event_seq) const;
  // Whether the answer to an edit is still to come.
  bool is_unanswered(EditId edit) const;
  // Whether an unanswered event asks for a cut.
  bool is_cut(std::uint64_t event_seq) const;
  // Whether an unanswered event sets a target.
  bool is_being_set(std::uint32_t target) const;
  // Whether a result for a target may still arrive: it is being set, or was accepted and is not over.
  bool expects(std::uint32_t target) const;
  // Whether a result at a frame is of an earlier target with this id, which the present one replaced. took_over_from:
  // the first frame that the present one can influence, if the other's result may still come.
  bool excludes(std::uint32_t target, std::uint64_t frame, std::optional<std::uint64_t> took_over_from) const;
  // The targets of which nothing is left at a frame; a session that is opened anew there does not get them.
  std::vector<std::uint32_t> passed_at(std::uint64_t frame) const;

  // Take the answer to the event with a number, and keep what was accepted. Returns the number of the edit, 0 for an
  // event that the library added itself, or nothing if no such event waits. taken: nothing if it was refused.
  std::optional<EditId> answer(std::uint64_t event_seq, const std::optional<Taken>& taken);

  // The server has opened the session: prompts and constraints of the opening are in force.
  void opened(const std::vector<Placement>& placements);

  // The session was opened anew by `reopening(base, ...)`: the new session has placed what is left of its constraints.
  void reopened(std::uint64_t base, const std::vector<Placement>& placements);

  // The history_frames asked for last; 0: the model's default.
  std::uint32_t history_frames() const { return open_.history_frames(); }

  // Drop the constraints before a frame: they have been played.
  void forget_before(std::uint64_t frame);

  // Drop a target whose result has arrived, even if it was met early.
  void end_target(std::uint32_t target);

  bool is_paused() const { return paused_; }

  // Whether any event has no answer yet.
  bool is_waiting() const { return !pending_.empty(); }

  // The session has ended: unanswered events get no answer.
  void drop_unanswered() { pending_.clear(); }

 private:
  struct Pending {
    EditId edit = 0;
    v1::SessionEvent event;
    BacklogShare share;
    EditId num_overtaken = 0;  // edits before `edit` that it has taken the place of
  };
  struct Held {
    v1::SessionEvent event;
    std::uint64_t frame = 0;  // the end of a velocity, the first frame of a cut
  };

  void accept(const v1::SessionEvent& event, const Taken& taken);
  void accept_options(const v1::SetOptions& options);
  void place(const std::vector<Placement>& placements);
  void accept_prompts(const v1::EditPrompts& edit, const Taken& taken);
  void put_prompt(v1::PromptSpan span, std::uint64_t playhead);
  std::vector<v1::PromptSpan> prompts_from(std::uint64_t base, std::size_t most) const;
  bool is_being_changed(std::uint32_t prompt_id) const;
  bool begins_after(const v1::Constraint& constraint, std::uint64_t frame) const;
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
  std::vector<v1::Constraint> constraints_;  // in the order they were set: of equal ones, the last holds
  std::map<std::uint32_t, Placement> placements_;
  std::optional<Held> velocity_;
  std::optional<Held> cut_;
  bool paused_ = false;
  bool opened_ = false;
};

}  // namespace motiongen
