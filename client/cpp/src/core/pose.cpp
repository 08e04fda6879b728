#include "motiongen/core/pose.hpp"

#include <cmath>
#include <cstddef>

namespace motiongen {
namespace {

struct Quaternion {
  float w, x, y, z;
};

struct Vector {
  float x, y, z;
};

Quaternion load(const float* from) { return {from[0], from[1], from[2], from[3]}; }

void store(const Quaternion& q, float* to) {
  to[0] = q.w;
  to[1] = q.x;
  to[2] = q.y;
  to[3] = q.z;
}

Quaternion multiply(const Quaternion& a, const Quaternion& b) {
  return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

// v + 2 u x (u x v + w v), u being the vector part of a unit quaternion.
Vector rotate(const Quaternion& q, const Vector& v) {
  const Vector t = {2 * (q.y * v.z - q.z * v.y), 2 * (q.z * v.x - q.x * v.z), 2 * (q.x * v.y - q.y * v.x)};
  return {v.x + q.w * t.x + (q.y * t.z - q.z * t.y), v.y + q.w * t.y + (q.z * t.x - q.x * t.z),
          v.z + q.w * t.z + (q.x * t.y - q.y * t.x)};
}

// Shoemake 1985, eq. for slerp; nearly equal rotations are mixed in a straight line, where the sines say nothing.
Quaternion slerp(const Quaternion& a, const Quaternion& b, float blend) {
  constexpr float kNearlyEqual = 0.9995F;
  const float cosine = a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
  const float sign = cosine < 0 ? -1.0F : 1.0F;
  float share_a = 1 - blend;
  float share_b = blend;
  if (cosine * sign < kNearlyEqual) {
    const float angle = std::acos(cosine * sign);
    const float sine = std::sin(angle);
    share_a = std::sin(share_a * angle) / sine;
    share_b = std::sin(share_b * angle) / sine;
  }
  share_b *= sign;
  const Quaternion mixed = {share_a * a.w + share_b * b.w, share_a * a.x + share_b * b.x, share_a * a.y + share_b * b.y,
                            share_a * a.z + share_b * b.z};
  const float length = std::sqrt(mixed.w * mixed.w + mixed.x * mixed.x + mixed.y * mixed.y + mixed.z * mixed.z);
  if (length == 0) return a;
  return {mixed.w / length, mixed.x / length, mixed.y / length, mixed.z / length};
}

}  // namespace

void interpolate(const Rig& rig, Span<const float> from, Span<const float> to, float blend, Span<float> out) {
  const std::size_t rotations_end = rig.rotation_column + 4 * std::size_t{rig.num_joints()};
  for (std::size_t column = 0; column < rig.row_width;) {
    if (column == rig.rotation_column) {
      for (; column < rotations_end; column += 4) {
        store(slerp(load(&from[column]), load(&to[column]), blend), &out[column]);
      }
    } else if (column == rig.contact_column) {
      const Span<const float> nearer = blend < 0.5F ? from : to;
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
