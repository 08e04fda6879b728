// Values of the C interface as the library has them.
#pragma once

#include "motiongen/client/types.hpp"
#include "motiongen/motiongen.h"

namespace motiongen::c {

// INVALID_ARGUMENT for a NULL, a form that nobody knows, or numbers that are missing.
Result<Target> target_of(const motiongen_target* given);
Result<Prompt> prompt_of(const motiongen_prompt* given);
Result<OptionsChange> change_of(const motiongen_options_change* given);

}  // namespace motiongen::c
