// The messages for planned opens, edits and closes; the same as motiongen_tools.bench.edits makes.
#pragma once

#include "character.hpp"
#include "load.pb.h"
#include "motiongen/v1/session.pb.h"

namespace motiongen::load {

v1::SessionEvent open_event(PlayedCharacter& character, const Load& load);

// value: the index of the prompt, or the edit's number within its rule.
v1::SessionEvent edit_event(PlayedCharacter& character, const Load& load, const Rule& rule, std::uint32_t value,
                            double intended_s, double now_s);

v1::SessionEvent close_event(PlayedCharacter& character);

}  // namespace motiongen::load
