// Conversion of the C interface's structs to the library's values.
#pragma once

#include "motiongen/client/types.hpp"
#include "motiongen/motiongen.h"

namespace motiongen::c {

// INVALID_ARGUMENT for NULL, an unknown form, or missing numbers.
Result<Target> target_of(const motiongen_target* given);
Result<Prompt> prompt_of(const motiongen_prompt* given);
Result<OptionsChange> change_of(const motiongen_options_change* given);

}  // namespace motiongen::c
