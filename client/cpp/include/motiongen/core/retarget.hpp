// Retarget: transfers frames of one of our rigs to the user's own skeleton, by a joint map.
//
// Let G(j) be the world rotation of our joint j, which is the identity in the neutral pose, and T(k) the orientation of
// the axes of the user's joint k when the body stands in that pose. If j drives k, the world rotation of k is G(j)
// T(k). Joints that nothing drives stay at rest. A map has the meaning that docs/data.md gives retarget files, in the
// opposite direction, as in the Python client; reading such a file is up to the caller.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

// A joint tree in our axes and its own units. Joint 0 is the root with parent -1, and parents precede their children.
// offsets: 3 a joint, its position on its parent in the parent's axes. rest_wxyz: 4 a joint, its rotation relative to
// its parent at rest; empty: no rotation.
struct UserSkeleton {
  std::vector<std::string> joint_names;
  std::vector<std::int32_t> parents;
  std::vector<float> offsets;
  std::vector<float> rest_wxyz;
};

// One of the user's joints follows one or two of ours.
struct Drive {
  std::string theirs;
  std::string ours;
  std::string ours_too;  // the joint turns between the two, at `fraction`; empty: as `ours`
  float fraction = 0;
  std::array<float, 4> axes_wxyz = {1, 0, 0, 0};  // T: from our axes to the joint's own
};

struct JointMap {
  float metres_per_unit = 1;
  std::vector<Drive> drives;
  std::vector<std::string> root_theirs;  // the midpoint of these joints of theirs
  std::vector<std::string> root_ours;    // is put at the midpoint of these of ours
  float scale = 0;                       // our metres for one of their metres; 0: from the lengths of the chains
  std::vector<std::vector<std::string>> chains_theirs;
  std::vector<std::vector<std::string>> chains_ours;
  // Their height ground_theirs corresponds to ground_ours_m. on_feet: instead, when the body stands in our neutral pose
  // with the lowest of feet_ours at ground_ours_m, the lowest of their feet is as high above their lowest joint as at
  // rest.
  bool on_feet = false;
  float ground_theirs = 0;
  float ground_ours_m = 0;
  std::vector<std::string> feet_ours;
};

// Retargets one session's frames to one skeleton. Allocates memory only when it is made.
class MOTIONGEN_API Retargeter {
 public:
  // NOT_FOUND for an unknown joint. INVALID_ARGUMENT for a tree or a map that contradicts itself, for numbers that are
  // not finite, and for quaternions that are not unit.
  static Result<Retargeter> make(const Rig& rig, const UserSkeleton& skeleton, const JointMap& map);

  Retargeter(Retargeter&&) noexcept;
  Retargeter& operator=(Retargeter&&) noexcept;
  ~Retargeter();

  // Retarget a frame. row: of the rig. root: 3 numbers in the skeleton's units; rotations_wxyz: 4 for each joint of the
  // skeleton, relative to its parent, joint 0 relative to the world, each with the sign nearer to the frame before.
  void apply(Span<const float> row, Span<float> root, Span<float> rotations_wxyz);

  float scale() const;

 private:
  struct State;
  explicit Retargeter(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
