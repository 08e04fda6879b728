// What is wrong with a skeleton and a joint map by themselves.
#pragma once

#include "motiongen/core/retarget.hpp"

namespace motiongen {

// INVALID_ARGUMENT for what is no tree, for lists of other lengths and for numbers that mean nothing.
Status check_skeleton(const UserSkeleton& skeleton);
Status check_numbers(const JointMap& map);

}  // namespace motiongen
