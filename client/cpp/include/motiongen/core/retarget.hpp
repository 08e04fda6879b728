// Retarget: frames of one of our rigs on somebody else's skeleton, by a joint map.
//
// With G(j) the world rotation of our joint j, whose neutral pose has none, and T(k) the way in which the user's joint
// k has its own axes when the body stands in that pose, k has the world rotation G(j) T(k). Joints that nothing drives
// stay as at rest. What a map means is what docs/data.md says of retarget files, read backward, as the Python client
// does; reading the file is the caller's affair.
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

// A joint tree in our axes, in its own units. Joint 0 is the root with parent -1, and parents precede their children.
// offsets: 3 a joint, where it is on its parent, in the parent's own axes. rest_wxyz: 4 a joint, how it is turned
// relative to its parent at rest; none: not at all.
struct UserSkeleton {
  std::vector<std::string> joint_names;
  std::vector<std::int32_t> parents;
  std::vector<float> offsets;
  std::vector<float> rest_wxyz;
};

// One of the user's joints turns as ours do.
struct Drive {
  std::string theirs;
  std::string ours;
  std::string ours_too;  // it lies between the two, at `fraction`; empty: as `ours`
  float fraction = 0;
  std::array<float, 4> axes_wxyz = {1, 0, 0, 0};  // T: from our axes to the joint's own
};

struct JointMap {
  float metres_per_unit = 1;
  std::vector<Drive> drives;
  std::vector<std::string> root_theirs;  // joints whose middle lies where
  std::vector<std::string> root_ours;    // that of these does
  float scale = 0;                       // metres of ours for one metre of theirs; 0: by the lengths of the chains
  std::vector<std::vector<std::string>> chains_theirs;
  std::vector<std::vector<std::string>> chains_ours;
  // Their height that lies where ours does. on_feet: instead the lowest of feet_ours is at ground_ours_m where the
  // lowest of those that they drive is as at rest.
  bool on_feet = false;
  float ground_theirs = 0;
  float ground_ours_m = 0;
  std::vector<std::string> feet_ours;
};

// One session's frames on one skeleton. Asks for memory when it is made only.
class MOTIONGEN_API Retargeter {
 public:
  // NOT_FOUND for a joint that is not there. INVALID_ARGUMENT for a tree or a map that contradicts itself, for numbers
  // that are not finite, and for quaternions of another length than 1.
  static Result<Retargeter> make(const Rig& rig, const UserSkeleton& skeleton, const JointMap& map);

  Retargeter(Retargeter&&) noexcept;
  Retargeter& operator=(Retargeter&&) noexcept;
  ~Retargeter();

  // A frame. row: of the rig. root: 3 numbers in the skeleton's units; rotations_wxyz: 4 a joint of the skeleton,
  // relative to the parent, joint 0 to the world, each of the sign that is nearer to the frame before.
  void apply(Span<const float> row, Span<float> root, Span<float> rotations_wxyz);

  float scale() const;

 private:
  struct State;
  explicit Retargeter(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
