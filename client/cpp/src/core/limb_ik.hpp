// Two-bone inverse kinematics: turns a leg's joints so that its end reaches a goal.
//
// The knee's place follows from the lengths of the two bones and the vector from hip to ankle (the law of cosines); it
// stays in the plane in which the leg is bent.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

#include "quaternion.hpp"

namespace motiongen {

using Rotation = BasicQuaternion<double>;
using Place = BasicVector<double>;

constexpr double kTiny = 1e-9;

inline Place operator+(const Place& a, const Place& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Place operator-(const Place& a, const Place& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Place operator*(double factor, const Place& a) { return {factor * a.x, factor * a.y, factor * a.z}; }
inline double dot(const Place& a, const Place& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline double length(const Place& a) { return std::sqrt(dot(a, a)); }

// The unit vector in a direction; zero for a zero vector.
inline Place direction(const Place& a) { return 1 / std::max(length(a), kTiny) * a; }

// The smallest rotation that turns one vector to the direction of another. They must not be opposite.
inline Rotation rotation_between(const Place& start, const Place& end) {
  const Place a = direction(start);
  const Place b = direction(end);
  const Rotation half = {1 + dot(a, b), a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return normalized(half, Rotation{1, 0, 0, 0});
}

// World rotations to apply after those of thigh and shin so that the ankle reaches `goal`. If that is farther away than
// the leg is long, the leg points to it. ahead: the direction in which a straight leg's knee bends.
inline std::pair<Rotation, Rotation> two_bone(const Place& hip, const Place& knee, const Place& ankle,
                                              const Place& goal, const Place& ahead) {
  const Place thigh = knee - hip;
  const Place shin = ankle - knee;
  const double upper = length(thigh);
  const double lower = length(shin);
  const Place reach = goal - hip;
  // for a leg of no length the lower bound exceeds the upper one, so std::clamp cannot be used
  const double distance = std::max(std::min(length(reach), upper + lower - kTiny), std::abs(upper - lower) + kTiny);
  const Place toward = direction(reach);
  const Rotation swung = rotation_between(ankle - hip, reach);
  const Place bent = rotate(swung, thigh);
  Place aside = bent - dot(bent, toward) * toward;
  if (length(aside) < 1e-4) aside = ahead - dot(ahead, toward) * toward;
  aside = direction(aside);
  const double along = (upper * upper - lower * lower + distance * distance) / (2 * distance);
  const Place new_thigh = along * toward + std::sqrt(std::max(upper * upper - along * along, 0.0)) * aside;
  const Place new_shin = distance * toward - new_thigh;
  const Rotation first = multiply(rotation_between(bent, new_thigh), swung);
  const Rotation second = multiply(rotation_between(rotate(first, shin), new_shin), first);
  return {first, second};
}

}  // namespace motiongen
