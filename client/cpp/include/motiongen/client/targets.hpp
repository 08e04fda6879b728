// Where a character shall be and when. A target is hard in time and soft in space: the model aims for it.
#pragma once

#include <cstdint>
#include <optional>
#include <variant>
#include <vector>

namespace motiongen {

// How far off is near enough for `Reached::met` and `Residual::met`; absent: what the model's catalogue entry says.
struct Tolerance {
  std::optional<float> position_m;
  std::optional<float> rotation_rad;
};

// The root on the ground at one frame, world metres; heading in radians, 0 faces +Z, absent leaves it free.
struct Waypoint {
  std::uint64_t frame = 0;
  float x_m = 0;
  float z_m = 0;
  std::optional<float> heading_rad;
  Tolerance tolerance;
};

// The root on the ground at consecutive frames. positions_m: (N, 2) x, z; headings_rad: N, or none.
struct RootTrajectory {
  std::uint64_t first_frame = 0;
  std::vector<float> positions_m;
  std::vector<float> headings_rad;
  Tolerance tolerance;
};

// World position of every joint of the rig at one frame. positions_m: (J, 3).
struct Keyframe {
  std::uint64_t frame = 0;
  std::vector<float> positions_m;
  Tolerance tolerance;
};

// World targets for some joints at one frame, the root (0) among them. positions_m: (K, 3); rotations_wxyz: (K, 4) unit
// quaternions, 0 0 0 0 for a free one, or none.
struct JointTargets {
  std::uint64_t frame = 0;
  std::vector<std::uint32_t> joints;
  std::vector<float> positions_m;
  std::vector<float> rotations_wxyz;
  Tolerance tolerance;
};

// A heading at one frame, wherever the body is.
struct HeadingTarget {
  std::uint64_t frame = 0;
  float heading_rad = 0;
  Tolerance tolerance;
};

// World rotations of some joints at one frame, wherever the body is. rotations_wxyz: (K, 4) unit quaternions.
struct JointRotations {
  std::uint64_t frame = 0;
  std::vector<std::uint32_t> joints;
  std::vector<float> rotations_wxyz;
  Tolerance tolerance;
};

using Target = std::variant<Waypoint, RootTrajectory, Keyframe, JointTargets, HeadingTarget, JointRotations>;

}  // namespace motiongen
