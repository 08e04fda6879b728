// What a session was told: the changes not yet answered, and what the accepted ones left it with. From this a session
// is opened again after a loss, so that nothing that the server took is lost, and nothing it has not answered either.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "motiongen/client/types.hpp"
#include "motiongen/v1/session.pb.h"

namespace motiongen {

class SessionBook {
 public:
  static constexpr std::uint32_t kPresentPrompt = 1;  // set without a frame; scheduled prompts have the ids above it

  // The first OpenSession, its prompts and constraints included.
  SessionBook(std::uint32_t session, v1::OpenSession open) : session_(session), open_(std::move(open)) {}

  // A constraint of the opening.
  void add_opening(v1::Constraint constraint) { *open_.add_constraints() = std::move(constraint); }

  std::uint32_t take_prompt_id() { return next_prompt_++; }
  std::uint32_t take_constraint_id() { return next_constraint_++; }

  // Scheduled prompts that were accepted and hold no longer once another takes over at `until`: those that have begun
  // by the playhead, without the one that holds until then.
  std::vector<std::uint32_t> begun_prompts(std::uint64_t playhead, bool spare_last) const;

  // Note an edit. Its frames are the timeline's. Returns its number; `event_seq` of the event is set.
  EditId add(v1::SessionEvent& event);

  // ---- on the wire

  // A new stream: the events of the session count from 1 again.
  void begin_stream() { next_seq_ = 1; }
  std::uint64_t take_seq() { return next_seq_++; }

  // The message that opens the session for the first time, or anew where `prior` (rows of patch_frames each, the last
  // of which is shown before frame `base`) says what it did; without it, it starts at its start pose.
  v1::OpenSession opening() const { return open_; }
  v1::OpenSession reopening(std::uint64_t base, std::uint32_t num_prior, std::string prior) const;

  // Every event up to this one has been answered.
  std::uint64_t answered_seq() const {
    return pending_.empty() ? next_seq_ - 1 : pending_.front().event.event_seq() - 1;
  }

  // Events that have no answer, as they were sent: what the server has taken of them it knows by their numbers.
  std::vector<v1::SessionEvent> repetitions(std::uint64_t base) const;

  // The same for a session that is opened anew: numbered anew and in order. A pause comes first where it is paused.
  std::vector<v1::SessionEvent> unanswered(std::uint64_t base);

  // The event as it is sent to a session whose frame 0 is `base`.
  static v1::SessionEvent shifted(v1::SessionEvent event, std::uint64_t base);

  // The answer to the event with a number: which edit it was, 0 for one of ours; nothing where none waits. What was
  // accepted is kept.
  std::optional<EditId> answer(std::uint64_t event_seq, bool accepted);

  // The server has opened it: prompts and constraints of the opening hold.
  void opened();

  // Constraints before a frame have been played and are not needed any more.
  void forget_before(std::uint64_t frame);

  bool is_paused() const { return paused_; }

 private:
  struct Pending {
    EditId edit = 0;
    v1::SessionEvent event;
  };

  void accept(const v1::SessionEvent& event);

  std::uint32_t session_;
  v1::OpenSession open_;
  std::uint64_t next_seq_ = 1;
  EditId next_edit_ = 1;
  std::uint32_t next_prompt_ = kPresentPrompt + 1;
  std::uint32_t next_constraint_ = 1;
  std::deque<Pending> pending_;
  std::map<std::uint32_t, v1::PromptSpan> prompts_;
  std::map<std::uint32_t, v1::Constraint> constraints_;
  bool paused_ = false;
  bool opened_ = false;
};

}  // namespace motiongen
