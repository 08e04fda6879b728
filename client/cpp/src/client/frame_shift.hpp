// Prompts and constraints between the timeline's frames and those of a session that was opened anew.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "motiongen/v1/session.pb.h"

namespace motiongen {

// A span counted from `base`; false where it is over by then. A start that has passed is "as soon as possible".
bool shift(v1::PromptSpan& span, std::uint64_t base);

// A constraint counted from `base`, a trajectory without the part that has passed; false where all of it has. One whose
// frames the server chooses stays as it is.
bool shift(v1::Constraint& constraint, std::uint64_t base);

// The event as it is sent to a session whose frame 0 is `base`, without what has passed; nothing where all of it has,
// or the prompts that it sets: those that it drops for them stay. A frame to go back to that the session does not have
// is left in where the server refuses it by its own rule.
std::optional<v1::SessionEvent> shifted(v1::SessionEvent event, std::uint64_t base);

// The targets that an event sets, and those of them that have passed for a session whose frame 0 is `base`.
std::vector<std::uint32_t> targets_of(const v1::SessionEvent& event);
std::vector<std::uint32_t> passed_targets_of(const v1::SessionEvent& event, std::uint64_t base);

}  // namespace motiongen
