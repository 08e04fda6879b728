#include "client/placing.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace motiongen {
namespace {

using Numbers = google::protobuf::RepeatedField<float>;

// Transforms from the character at its anchor to the world: a turn about the up axis, then a translation.
class Anchor {
 public:
  explicit Anchor(const Placement& placement)
      : heading_(static_cast<double>(placement.anchor_heading_rad)),
        x_(static_cast<double>(placement.anchor_x_m)),
        z_(static_cast<double>(placement.anchor_z_m)) {}

  float heading(float seen) const { return static_cast<float>(static_cast<double>(seen) + heading_); }

  // Each group of `stride` numbers begins with an x and ends with a z.
  void places(int stride, Numbers* numbers) const {
    const double cosine = std::cos(heading_);
    const double sine = std::sin(heading_);
    for (int at = 0; at + stride <= numbers->size(); at += stride) {
      const double x = static_cast<double>(numbers->Get(at));
      const double z = static_cast<double>(numbers->Get(at + stride - 1));
      numbers->Set(at, static_cast<float>(cosine * x + sine * z + x_));
      numbers->Set(at + stride - 1, static_cast<float>(cosine * z - sine * x + z_));
    }
  }

  // Quaternions w x y z; 0 0 0 0 stays.
  void rotations(Numbers* numbers) const {
    const double cosine = std::cos(heading_ / 2);
    const double sine = std::sin(heading_ / 2);
    for (int at = 0; at + 4 <= numbers->size(); at += 4) {
      const double w = static_cast<double>(numbers->Get(at));
      const double x = static_cast<double>(numbers->Get(at + 1));
      const double y = static_cast<double>(numbers->Get(at + 2));
      const double z = static_cast<double>(numbers->Get(at + 3));
      numbers->Set(at, static_cast<float>(cosine * w - sine * y));
      numbers->Set(at + 1, static_cast<float>(cosine * x + sine * z));
      numbers->Set(at + 2, static_cast<float>(cosine * y + sine * w));
      numbers->Set(at + 3, static_cast<float>(cosine * z - sine * x));
    }
  }

 private:
  double heading_;
  double x_;
  double z_;
};

// A message with an x, a z and an optional heading.
template <class Message>
void place_into_world(const Anchor& anchor, Message* message) {
  Numbers place;
  place.Add(message->x());
  place.Add(message->z());
  anchor.places(2, &place);
  message->set_x(place[0]);
  message->set_z(place[1]);
  if (message->has_heading()) message->set_heading(anchor.heading(message->heading()));
}

void into_world(v1::Constraint& constraint, const Anchor& anchor) {
  if (constraint.has_waypoint()) {
    place_into_world(anchor, constraint.mutable_waypoint());
  } else if (constraint.has_foot_contact()) {
    place_into_world(anchor, constraint.mutable_foot_contact());
  } else if (constraint.has_heading()) {
    constraint.mutable_heading()->set_heading(anchor.heading(constraint.heading().heading()));
  } else if (constraint.has_root_trajectory()) {
    anchor.places(2, constraint.mutable_root_trajectory()->mutable_positions());
    for (float& each : *constraint.mutable_root_trajectory()->mutable_headings()) each = anchor.heading(each);
  } else if (constraint.has_root_path()) {
    anchor.places(2, constraint.mutable_root_path()->mutable_positions());
  } else if (constraint.has_keyframe()) {
    anchor.places(3, constraint.mutable_keyframe()->mutable_positions());
  } else if (constraint.has_joint_targets()) {
    anchor.places(3, constraint.mutable_joint_targets()->mutable_positions());
    anchor.rotations(constraint.mutable_joint_targets()->mutable_rotations());
  } else if (constraint.has_joint_rotations()) {
    anchor.rotations(constraint.mutable_joint_rotations()->mutable_rotations());
  }
}

}  // namespace

v1::Constraint placed(v1::Constraint constraint, const Placement& placement) {
  if (constraint.relative_to_character()) into_world(constraint, Anchor(placement));
  constraint.set_relative_to_character(false);
  if (constraint.frames_from_effect()) {
    constraint.set_frame(constraint.frame() + placement.anchor_frame);
    if (constraint.has_last_frame()) constraint.set_last_frame(constraint.last_frame() + placement.anchor_frame);
  }
  constraint.set_frames_from_effect(false);
  return constraint;
}

v1::Constraint path_left(v1::Constraint constraint, const Placement& placement, std::uint64_t frame) {
  auto* positions = constraint.mutable_root_path()->mutable_positions();
  std::vector<double> way_m;  // the distance to each corner
  double at_x = static_cast<double>(placement.anchor_x_m);
  double at_z = static_cast<double>(placement.anchor_z_m);
  double length_m = 0;
  for (int at = 0; at + 2 <= positions->size(); at += 2) {
    const double x = static_cast<double>(positions->Get(at));
    const double z = static_cast<double>(positions->Get(at + 1));
    length_m += std::hypot(x - at_x, z - at_z);
    way_m.push_back(length_m);
    at_x = x;
    at_z = z;
  }
  if (way_m.empty() || frame <= placement.first_frame) return constraint;
  const std::uint64_t frames = std::max<std::uint64_t>(placement.last_frame - placement.first_frame, 1);
  const double share = static_cast<double>(frame - placement.first_frame) / static_cast<double>(frames);
  std::ptrdiff_t passed = 0;
  for (std::size_t corner = 0; corner + 1 < way_m.size(); ++corner) passed += way_m[corner] < share * length_m ? 1 : 0;
  positions->erase(positions->begin(), positions->begin() + 2 * passed);
  return constraint;
}

}  // namespace motiongen
