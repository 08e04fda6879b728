// Unit quaternions w x y z, and the vectors that they rotate.
#pragma once

#include <cmath>

namespace motiongen {

template <class T>
struct BasicQuaternion {
  T w, x, y, z;
};

template <class T>
struct BasicVector {
  T x, y, z;
};

using Quaternion = BasicQuaternion<float>;
using Vector = BasicVector<float>;

inline Quaternion load(const float* from) { return {from[0], from[1], from[2], from[3]}; }

inline void store(const Quaternion& q, float* to) {
  to[0] = q.w;
  to[1] = q.x;
  to[2] = q.y;
  to[3] = q.z;
}

template <class T>
T dot(const BasicQuaternion<T>& a, const BasicQuaternion<T>& b) {
  return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
}

// The rotation b, followed by a.
template <class T>
BasicQuaternion<T> multiply(const BasicQuaternion<T>& a, const BasicQuaternion<T>& b) {
  return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

// The inverse rotation.
template <class T>
BasicQuaternion<T> inverse(const BasicQuaternion<T>& q) {
  return {q.w, -q.x, -q.y, -q.z};
}

// Scaled to length 1; `otherwise` if its length is 0.
template <class T>
BasicQuaternion<T> normalized(const BasicQuaternion<T>& q, const BasicQuaternion<T>& otherwise) {
  const T length = std::sqrt(dot(q, q));
  if (!(length > 0)) return otherwise;
  return {q.w / length, q.x / length, q.y / length, q.z / length};
}

// v + 2 u x (u x v + w v), u being the vector part of a unit quaternion.
template <class T>
BasicVector<T> rotate(const BasicQuaternion<T>& q, const BasicVector<T>& v) {
  const BasicVector<T> t = {2 * (q.y * v.z - q.z * v.y), 2 * (q.z * v.x - q.x * v.z), 2 * (q.x * v.y - q.y * v.x)};
  return {v.x + q.w * t.x + (q.y * t.z - q.z * t.y), v.y + q.w * t.y + (q.z * t.x - q.x * t.z),
          v.z + q.w * t.z + (q.x * t.y - q.y * t.x)};
}

// Shoemake 1985, eq. for slerp; nearly equal rotations are interpolated linearly, since the sines vanish.
inline Quaternion slerp(const Quaternion& a, const Quaternion& b, float blend) {
  constexpr float kNearlyEqual = 0.9995F;
  const float cosine = dot(a, b);
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
  return normalized(mixed, a);
}

}  // namespace motiongen
