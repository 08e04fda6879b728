#include "motiongen/core/pose.hpp"

#include <cstddef>

#include "quaternion.hpp"

namespace motiongen {
void interpolate(const Rig& rig, Span<const float> from, Span<const float> to, float blend, Span<float> out) {
  const std::size_t rotations_end = rig.rotation_column + 4 * std::size_t{rig.num_joints()};
  const Span<const float> nearer = blend > 0.5F ? to : from;
  for (std::size_t column = rig.own_width; column < rig.row_width; ++column) out[column] = nearer[column];
  for (std::size_t column = 0; column < rig.own_width;) {
    if (column == rig.rotation_column) {
      for (; column < rotations_end; column += 4) {
        store(slerp(load(&from[column]), load(&to[column]), blend), &out[column]);
      }
    } else if (column == rig.contact_column) {
      for (const std::size_t end = column + 4; column < end; ++column) out[column] = nearer[column];
    } else {
      out[column] = from[column] + blend * (to[column] - from[column]);
      ++column;
    }
  }
}

void joint_transforms(const Rig& rig, Span<const float> row, Span<float> positions_m, Span<float> rotations_wxyz) {
  const float* rotations = row.data() + rig.rotation_column;
  const float* root = row.data() + rig.root_column;
  for (std::size_t joint = 0; joint < rig.num_joints(); ++joint) {
    const Quaternion local = load(rotations + 4 * joint);
    if (joint == 0) {
      store(local, &rotations_wxyz[0]);
      for (std::size_t axis = 0; axis < 3; ++axis) positions_m[axis] = root[axis];
      continue;
    }
    const auto parent = static_cast<std::size_t>(rig.parents[joint]);
    const Quaternion above = load(&rotations_wxyz[4 * parent]);
    const float* offset = &rig.offsets_m[3 * joint];
    const Vector away = rotate(above, {offset[0], offset[1], offset[2]});
    store(multiply(above, local), &rotations_wxyz[4 * joint]);
    positions_m[3 * joint] = positions_m[3 * parent] + away.x;
    positions_m[3 * joint + 1] = positions_m[3 * parent + 1] + away.y;
    positions_m[3 * joint + 2] = positions_m[3 * parent + 2] + away.z;
  }
}

void joint_positions(const Rig& rig, Span<const float> row, Span<float> positions_m) {
  float rotations[4 * Rig::kMostJoints];
  joint_transforms(rig, row, positions_m, {rotations, 4 * std::size_t{rig.num_joints()}});
}

}  // namespace motiongen
