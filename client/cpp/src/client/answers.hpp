// The latest answers to a session's edits, kept for later waits.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

#include "motiongen/client/types.hpp"

namespace motiongen {

// About how much memory an answer takes.
inline std::size_t bytes_of(const Outcome& outcome) {
  std::size_t bytes = sizeof outcome + outcome.placements.size() * sizeof(Placement) + outcome.status.reason().size() +
                      outcome.status.message().size() + outcome.field.size() + outcome.allowed.size();
  for (const Warning& each : outcome.warnings) {
    bytes += sizeof each + each.reason.size() + each.message.size() + each.field.size();
  }
  for (const OtherServer& each : outcome.other_servers) {
    bytes += sizeof each + each.address.size() + each.routing_key.size();
  }
  return bytes;
}

class AnswerBook {
 public:
  static constexpr std::size_t kMost = 1024;
  static constexpr std::size_t kMostBytes = std::size_t{1} << 24;

  // Take the answer to the edits from `first` to `last`. The oldest ones are dropped for it, if need be.
  void note(EditId first, EditId last, Outcome outcome) {
    bytes_ += bytes_of(outcome);
    answers_.push_back({first, last, std::move(outcome)});
    while (answers_.size() > kMost || (bytes_ > kMostBytes && answers_.size() > 1)) {
      bytes_ -= bytes_of(answers_.front().outcome);
      answers_.pop_front();
    }
  }

  std::optional<Outcome> find(EditId edit) const {
    for (const Answer& each : answers_) {
      if (each.first <= edit && edit <= each.last) return each.outcome;
    }
    return std::nullopt;
  }

 private:
  struct Answer {
    EditId first = 0;
    EditId last = 0;
    Outcome outcome;
  };

  std::deque<Answer> answers_;
  std::size_t bytes_ = 0;
};

}  // namespace motiongen
