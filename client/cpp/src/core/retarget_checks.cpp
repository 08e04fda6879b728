#include "retarget_checks.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "quaternion.hpp"

namespace motiongen {
namespace {

constexpr float kUnitTolerance = 1e-3F;  // of the length of a quaternion

template <class Numbers>
bool all_finite(const Numbers& numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](float number) { return std::isfinite(number); });
}

bool is_turn(const float* wxyz) {
  const Quaternion turn = load(wxyz);
  return std::abs(std::sqrt(dot(turn, turn)) - 1) <= kUnitTolerance;  // false for NaN
}

}  // namespace

Status check_skeleton(const UserSkeleton& skeleton) {
  const std::size_t count = skeleton.joint_names.size();
  if (count == 0 || count > Rig::kMostJoints || skeleton.parents.size() != count ||
      skeleton.offsets.size() != 3 * count || (!skeleton.rest_wxyz.empty() && skeleton.rest_wxyz.size() != 4 * count)) {
    return invalid("skeleton", std::to_string(count) + " joints and lists of other lengths",
                   "1 to 512 joints, a parent and 3 offsets for each, and 4 numbers of rest_wxyz or none");
  }
  for (std::size_t joint = 0; joint < count; ++joint) {
    const std::int64_t parent = skeleton.parents[joint];
    if (parent < -1 || parent >= static_cast<std::int64_t>(joint) || (parent < 0) != (joint == 0)) {
      return invalid("skeleton.parents", std::to_string(parent) + " for joint " + std::to_string(joint),
                     "-1 for joint 0 alone, parents first");
    }
    const std::string& name = skeleton.joint_names[joint];
    const auto first = std::find(skeleton.joint_names.begin(), skeleton.joint_names.end(), name);
    if (first - skeleton.joint_names.begin() != static_cast<std::ptrdiff_t>(joint)) {
      return invalid("skeleton.joint_names", "\"" + name + "\" twice", "each name once");
    }
    if (!skeleton.rest_wxyz.empty() && !is_turn(&skeleton.rest_wxyz[4 * joint])) {
      return invalid("skeleton.rest_wxyz", "no rotation for joint " + name, "unit quaternions w, x, y, z");
    }
  }
  if (!all_finite(skeleton.offsets)) return invalid("skeleton.offsets", "a number that is not finite", "finite ones");
  return {};
}

Status check_numbers(const JointMap& map) {
  if (!(map.metres_per_unit > 0) || !(map.scale >= 0) || !std::isfinite(map.metres_per_unit) ||
      !std::isfinite(map.scale)) {
    return invalid("metres_per_unit, scale", std::to_string(map.metres_per_unit) + ", " + std::to_string(map.scale),
                   "finite numbers above 0; a scale of 0 goes by the chains");
  }
  if (!std::isfinite(map.ground_theirs) || !std::isfinite(map.ground_ours_m)) {
    return invalid("ground_theirs, ground_ours_m",
                   std::to_string(map.ground_theirs) + ", " + std::to_string(map.ground_ours_m), "finite numbers");
  }
  for (const Drive& drive : map.drives) {
    if (!is_turn(drive.axes_wxyz.data())) {
      return invalid("axes_wxyz", "no rotation for " + drive.theirs, "a unit quaternion w, x, y, z");
    }
    if (!(drive.fraction >= 0 && drive.fraction <= 1)) {
      return invalid("fraction", std::to_string(drive.fraction) + " for " + drive.theirs, "0 to 1");
    }
  }
  return {};
}

}  // namespace motiongen
