// Where a session's targets were put and what became of them, kept for a while for whoever asks or waits.
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
  // Take what was told. False where it is known: a server repeats itself to a session that resumes.
  bool note(const Reached& told);
  // Of what was answered: once that is settled.
  void note(const Placement& placed);
  // No server has this target, and none will tell of it. One that was told of stays so.
  void refuse(std::uint32_t target, const Status& why);

  // Another target is to take the id: what is known of the one before does not hold for it.
  void forget(std::uint32_t target);
  // The other one was taken, or it was not and what was forgotten holds again. is_last: none that takes the id is on
  // its way any more.
  void settle(std::uint32_t target, bool was_taken, bool is_last);

  // The newest that is known, if anything is.
  std::optional<Reached> find(std::uint32_t target) const;
  std::optional<Placement> find_placement(std::uint32_t target) const;
  std::optional<Status> find_refusal(std::uint32_t target) const;

 private:
  static constexpr std::size_t kKept = 1024;  // of each

  struct Forgotten {
    std::optional<Reached> told;
    std::optional<Placement> placed;
    std::optional<Status> refused;
  };

  std::deque<Reached> told_;
  std::deque<std::pair<std::uint32_t, std::uint64_t>> heard_;  // target and frame of all that was told of late
  std::deque<Placement> placements_;
  std::deque<std::pair<std::uint32_t, Status>> refused_;
  std::map<std::uint32_t, Forgotten> forgotten_;  // by the ids that edits on their way replace
};

}  // namespace motiongen
