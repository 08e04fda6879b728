// A record of where a session's targets were placed and what became of them, kept for a while for later queries and
// waits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <utility>

#include "motiongen/client/types.hpp"

namespace motiongen {

class ReachedBook {
 public:
  // Take a result. False if it is known already: a server repeats results to a session that resumes. is_former: it is
  // of a target whose id has been taken by another since.
  bool note(const Reached& told, bool is_former = false);
  // Take the placement of a target whose edit was answered, after `settle`.
  void note(const Placement& placed);
  // The server does not have this target, so no result will come. Ignored if a result has come already.
  void refuse(std::uint32_t target, const Status& why);

  // Another target is to take this id: what is known of the one before does not apply to it.
  void forget(std::uint32_t target);
  // The session was resumed. Until frames come, results follow answers that may have been given after them.
  void begin_replay();
  // From now on, answers and results come in the order in which the server makes them.
  void end_replay();
  // An edit that takes this id was accepted; before `settle`. effective_frame: the first frame that it can influence.
  void take_over(std::uint32_t target, std::uint64_t effective_frame);
  // The first frame that a target can influence, if it has taken over from another, whose result may still come.
  std::optional<std::uint64_t> took_over_from(std::uint32_t target) const;

  // The edit with the other target was answered: accepted, or refused so that what was forgotten applies again.
  // is_last: no other unanswered edit takes this id.
  void settle(std::uint32_t target, bool was_taken, bool is_last);

  // The newest that is known, if any.
  std::optional<Reached> find(std::uint32_t target) const;
  std::optional<Placement> find_placement(std::uint32_t target) const;
  std::optional<Status> find_refusal(std::uint32_t target) const;

 private:
  static constexpr std::size_t kKept = 1024;  // of each kind

  struct Forgotten {
    std::optional<Reached> told;
    std::optional<Placement> placed;
    std::optional<Status> refused;
  };

  std::deque<Reached> told_;
  std::deque<std::pair<std::uint32_t, std::uint64_t>> heard_;  // target and frame of the latest results
  std::deque<Placement> placements_;
  std::deque<std::pair<std::uint32_t, Status>> refused_;
  std::map<std::uint32_t, Forgotten> forgotten_;  // by the ids that unanswered edits replace
  bool is_replay_ = false;
  std::map<std::uint32_t, std::uint64_t> took_over_;  // in the replay: id and first frame of those that did
};

}  // namespace motiongen
