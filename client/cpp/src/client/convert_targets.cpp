// Targets: their checks, and their conversion to the contract's messages.
#include <cmath>
#include <string>

#include "client/convert.hpp"
#include "client/texts.hpp"

namespace motiongen::convert {
namespace {

Status wrong_length(const char* field, std::size_t given, const std::string& allowed) {
  return invalid(field, std::to_string(given) + " numbers", allowed);
}

Status not_finite(const char* field) { return invalid(field, "a number that is not finite", "finite numbers"); }

struct Checker {
  Status operator()(const Waypoint& target) const {
    const bool finite =
        std::isfinite(target.x_m) && std::isfinite(target.z_m) && std::isfinite(target.heading_rad.value_or(0));
    return finite ? Status() : not_finite("Waypoint");
  }
  Status operator()(const RootTrajectory& target) const {
    const std::size_t frames = target.positions_m.size() / 2;
    if (frames == 0 || target.positions_m.size() % 2 != 0) {
      return wrong_length("RootTrajectory::positions_m", target.positions_m.size(), "x and z of one frame or more");
    }
    if (!target.headings_rad.empty() && target.headings_rad.size() != frames) {
      return wrong_length("RootTrajectory::headings_rad", target.headings_rad.size(),
                          std::to_string(frames) + ", one a position, or none");
    }
    return all_finite(target.positions_m) && all_finite(target.headings_rad) ? Status() : not_finite("RootTrajectory");
  }
  Status operator()(const Keyframe& target) const {
    if (target.positions_m.empty() || target.positions_m.size() % 3 != 0) {
      return wrong_length("Keyframe::positions_m", target.positions_m.size(), "x, y and z of every joint");
    }
    return all_finite(target.positions_m) ? Status() : not_finite("Keyframe");
  }
  Status operator()(const JointTargets& target) const {
    const std::size_t joints = target.joints.size();
    if (joints == 0 || target.positions_m.size() != 3 * joints) {
      return wrong_length("JointTargets::positions_m", target.positions_m.size(), "x, y and z of each of its joints");
    }
    if (!target.rotations_wxyz.empty() && target.rotations_wxyz.size() != 4 * joints) {
      return wrong_length("JointTargets::rotations_wxyz", target.rotations_wxyz.size(),
                          "w, x, y and z of each of its joints, or none");
    }
    return all_finite(target.positions_m) && all_finite(target.rotations_wxyz) ? Status() : not_finite("JointTargets");
  }
  Status operator()(const HeadingTarget& target) const {
    return std::isfinite(target.heading_rad) ? Status() : not_finite("HeadingTarget");
  }
  Status operator()(const JointRotations& target) const {
    if (target.joints.empty() || target.rotations_wxyz.size() != 4 * target.joints.size()) {
      return wrong_length("JointRotations::rotations_wxyz", target.rotations_wxyz.size(),
                          "w, x, y and z of each of its joints");
    }
    return all_finite(target.rotations_wxyz) ? Status() : not_finite("JointRotations");
  }
  Status operator()(const RootPath& target) const {
    if (target.corners_m.empty() || target.corners_m.size() % 2 != 0) {
      return wrong_length("RootPath::corners_m", target.corners_m.size(), "x and z of one corner or more");
    }
    const bool finite = all_finite(target.corners_m) && std::isfinite(target.speed_mps.value_or(0)) &&
                        std::isfinite(target.smoothing_m.value_or(0));
    return finite ? Status() : not_finite("RootPath");
  }
  Status operator()(const FootContact& target) const {
    const bool finite =
        std::isfinite(target.x_m) && std::isfinite(target.z_m) && std::isfinite(target.heading_rad.value_or(0));
    return finite ? check_utf8("FootContact::limb", target.limb) : not_finite("FootContact");
  }
};

struct Writer {
  v1::Constraint* message;

  void operator()(const Waypoint& target) const {
    message->set_frame(target.frame);
    auto* waypoint = message->mutable_waypoint();
    waypoint->set_x(target.x_m);
    waypoint->set_z(target.z_m);
    if (target.heading_rad) waypoint->set_heading(*target.heading_rad);
  }
  void operator()(const RootTrajectory& target) const {
    message->set_frame(target.first_frame);
    auto* path = message->mutable_root_trajectory();
    path->mutable_positions()->Add(target.positions_m.begin(), target.positions_m.end());
    path->mutable_headings()->Add(target.headings_rad.begin(), target.headings_rad.end());
  }
  void operator()(const Keyframe& target) const {
    message->set_frame(target.frame);
    message->mutable_keyframe()->mutable_positions()->Add(target.positions_m.begin(), target.positions_m.end());
  }
  void operator()(const JointTargets& target) const {
    message->set_frame(target.frame);
    auto* joints = message->mutable_joint_targets();
    joints->mutable_joints()->Add(target.joints.begin(), target.joints.end());
    joints->mutable_positions()->Add(target.positions_m.begin(), target.positions_m.end());
    joints->mutable_rotations()->Add(target.rotations_wxyz.begin(), target.rotations_wxyz.end());
  }
  void operator()(const HeadingTarget& target) const {
    message->set_frame(target.frame);
    message->mutable_heading()->set_heading(target.heading_rad);
  }
  void operator()(const JointRotations& target) const {
    message->set_frame(target.frame);
    auto* joints = message->mutable_joint_rotations();
    joints->mutable_joints()->Add(target.joints.begin(), target.joints.end());
    joints->mutable_rotations()->Add(target.rotations_wxyz.begin(), target.rotations_wxyz.end());
  }
  void operator()(const RootPath& target) const {
    auto* path = message->mutable_root_path();
    path->mutable_positions()->Add(target.corners_m.begin(), target.corners_m.end());
    if (target.speed_mps) path->set_speed_mps(*target.speed_mps);
    if (target.smoothing_m) path->set_smoothing_m(*target.smoothing_m);
  }
  void operator()(const FootContact& target) const {
    message->set_frame(target.frame);
    auto* foot = message->mutable_foot_contact();
    foot->set_limb(target.limb);
    foot->set_x(target.x_m);
    foot->set_z(target.z_m);
    if (target.heading_rad) foot->set_heading(*target.heading_rad);
  }
};

Tolerance tolerance_of(const Target& target) {
  return std::visit([](const auto& each) { return each.tolerance; }, target.form);
}

Status check_tolerance(const Tolerance& tolerance) {
  for (const auto& each : {tolerance.position_m, tolerance.rotation_rad}) {
    if (each && !(std::isfinite(*each) && *each >= 0)) {
      return invalid("tolerance", std::to_string(*each), "metres and radians of 0 or more");
    }
  }
  return {};
}

}  // namespace

Status check(const Target& target) {
  Status checked = check_tolerance(tolerance_of(target));
  if (checked && target.weight && !(*target.weight > 0 && *target.weight <= 10)) {
    checked = invalid("weight", std::to_string(*target.weight), "a number above 0, at most 10, or none for 1");
  }
  return checked ? std::visit(Checker{}, target.form) : checked;
}

v1::Constraint constraint(std::uint32_t id, const Target& target) {
  v1::Constraint message;
  message.set_constraint_id(id);
  std::visit(Writer{&message}, target.form);
  if (target.last_frame) message.set_last_frame(*target.last_frame);
  message.set_at_any_frame(target.at_any_frame);
  message.set_frames_from_effect(target.frames_from_effect);
  message.set_relative_to_character(target.relative_to_character);
  if (target.weight) message.set_weight(*target.weight);
  const Tolerance tolerance = tolerance_of(target);
  if (tolerance.position_m) message.set_tolerance_m(*tolerance.position_m);
  if (tolerance.rotation_rad) message.set_tolerance_rad(*tolerance.rotation_rad);
  return message;
}

}  // namespace motiongen::convert
