// Targets: where a character should be, and when. A target is exact in time and soft in space: the model aims for it.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace motiongen {

// How far off a target counts as met (`Reached::met`, `Residual::met`); absent: the model's default in the catalogue.
struct Tolerance {
  std::optional<float> position_m;
  std::optional<float> rotation_rad;
};

// The root's ground position at one frame, world metres; heading in radians, 0 faces +Z, absent: free.
struct Waypoint {
  std::uint64_t frame = 0;
  float x_m = 0;
  float z_m = 0;
  std::optional<float> heading_rad;
  Tolerance tolerance;
};

// The root's ground position at consecutive frames. positions_m: (N, 2) x, z; headings_rad: N, or empty: free.
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

// World positions of some joints at one frame. If the root (0) is not among them, it moves only as far as the joints
// need; given alone, it has a height too. positions_m: (K, 3); rotations_wxyz: (K, 4) unit quaternions, 0 0 0 0 for a
// free one, or empty: all free.
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

// A path over the ground through corners, from where the character is when it takes effect. corners_m: (N, 2) x, z.
struct RootPath {
  std::vector<float> corners_m;
  std::optional<float> speed_mps;    // on straight stretches; absent: 1.2
  std::optional<float> smoothing_m;  // how far corners may be cut; absent: 0.3
  Tolerance tolerance;
};

// A foot that stands flat at one frame; x_m, z_m: its ankle. limb: "LeftFoot" or "RightFoot", of `Rig::limbs`.
struct FootContact {
  std::uint64_t frame = 0;
  std::string limb;
  float x_m = 0;
  float z_m = 0;
  std::optional<float> heading_rad;  // of the foot; absent: free
  Tolerance tolerance;
};

using TargetForm = std::variant<Waypoint, RootTrajectory, Keyframe, JointTargets, HeadingTarget, JointRotations,
                                RootPath, FootContact>;

// A form and what it leaves to the server; `Outcome::placements` tells where the server put it. Any form converts to
// it:
//   Target there = Waypoint{0, 2, 5, {}, {}};
//   there.at_any_frame = true;
struct Target {
  TargetForm form;
  std::optional<std::uint64_t> last_frame;  // may be met at any frame from the form's own to this one
  bool at_any_frame = false;                // as soon as a person can get there; the form's frame is 0
  bool frames_from_effect = false;          // frames count from the one at which the edit takes effect
  bool relative_to_character = false;  // places and angles are relative to the character then: x to its left, z ahead
  std::optional<float> weight;         // above 0, at most 10; 1, or absent: must be met; below 1: should be met

  Target() = default;
  template <class Form, class = std::enable_if_t<std::is_constructible_v<TargetForm, Form> &&
                                                 !std::is_same_v<std::decay_t<Form>, Target>>>
  Target(Form&& given) : form(std::forward<Form>(given)) {}  // NOLINT: converts on purpose
};

}  // namespace motiongen
