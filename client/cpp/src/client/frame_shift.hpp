// Shifts prompts and constraints from the timeline's frames to those of a session that was opened anew.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "motiongen/v1/session.pb.h"

namespace motiongen {

// Make a span count from `base`; false if it is over by then. A start that has passed becomes "as soon as possible".
bool shift(v1::PromptSpan& span, std::uint64_t base);

// Make a constraint count from `base`, a trajectory without the part that has passed; false if all of it has passed. A
// constraint whose frames the server chooses stays as it is.
bool shift(v1::Constraint& constraint, std::uint64_t base);

// The event as it is sent to a session whose frame 0 is `base`, without what has passed. Nothing if all of it has
// passed, or all prompts that it sets: the prompts that it removes to make way for them then stay. A Seek to a frame
// that the session does not have is sent all the same, for the server to refuse.
std::optional<v1::SessionEvent> shifted(v1::SessionEvent event, std::uint64_t base);

// The targets that an event sets, and those of them that are over before the first frame of a session whose frame 0 is
// `base`.
std::vector<std::uint32_t> targets_of(const v1::SessionEvent& event);
std::vector<std::uint32_t> passed_targets_of(const v1::SessionEvent& event, std::uint64_t base);

}  // namespace motiongen
