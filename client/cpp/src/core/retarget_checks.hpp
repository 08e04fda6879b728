// Checks of a skeleton and a joint map by themselves.
#pragma once

#include "motiongen/core/retarget.hpp"

namespace motiongen {

// INVALID_ARGUMENT if it is no tree, lists have the wrong lengths or numbers make no sense.
Status check_skeleton(const UserSkeleton& skeleton);
Status check_numbers(const JointMap& map);

}  // namespace motiongen
