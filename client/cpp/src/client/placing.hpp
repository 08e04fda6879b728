// Constraints as the server has placed them: in frames of the timeline and world coordinates. A session that is opened
// anew is told them in this form: what was asked "from here" must not be asked again from another place.
#pragma once

#include <cstdint>

#include "motiongen/client/types.hpp"
#include "motiongen/v1/motion.pb.h"

namespace motiongen {

// The same constraint without anything relative to where or when it took effect.
v1::Constraint placed(v1::Constraint constraint, const Placement& placement);

// What is left of a placed path at a frame: the corners still ahead, judged by the share of its frames that are over.
v1::Constraint path_left(v1::Constraint constraint, const Placement& placement, std::uint64_t frame);

}  // namespace motiongen
