// The C interface of the helpers for game engines.
#include <algorithm>

#include "c/structs.hpp"
#include "motiongen/core/axes.hpp"
#include "motiongen/core/steering.hpp"

using motiongen::Axes;
using motiongen::c::answer;
using motiongen::c::missing;

namespace {

const Axes* axes_of(uint32_t number) {
  static constexpr const Axes* kKnown[] = {&motiongen::kUnreal, &motiongen::kUnity, &motiongen::kGodot,
                                           &motiongen::kRos};
  return number >= 1 && number <= 4 ? kKnown[number - 1] : nullptr;
}

motiongen_code unknown_axes(uint32_t number, motiongen_error* error) {
  return answer(motiongen::invalid("axes", std::to_string(number), "MOTIONGEN_AXES_UNREAL to MOTIONGEN_AXES_ROS"),
                error);
}

}  // namespace

motiongen_code motiongen_stick_velocity(float right, float forward, float camera_heading_rad, float speed_mps,
                                        float dead_zone, float* x_mps, float* z_mps, motiongen_error* error) {
  if (x_mps == nullptr || z_mps == nullptr) return missing("x_mps, z_mps", error);
  const auto found = motiongen::stick_velocity(right, forward, {camera_heading_rad, speed_mps, dead_zone});
  if (found) *x_mps = found.value().x;
  if (found) *z_mps = found.value().z;
  return answer(found.status(), error);
}

motiongen_code motiongen_drawn_corners(const float* points_m, uint32_t num_points, float within_m, float* corners_m,
                                       uint32_t* num_corners, motiongen_error* error) {
  if (points_m == nullptr || corners_m == nullptr || num_corners == nullptr) {
    return missing("points_m, corners_m, num_corners", error);
  }
  const auto found = motiongen::drawn_corners({points_m, 2 * std::size_t{num_points}}, within_m);
  if (!found) return answer(found.status(), error);
  std::copy(found.value().begin(), found.value().end(), corners_m);
  *num_corners = static_cast<uint32_t>(found.value().size() / 2);
  return answer({}, error);
}

motiongen_code motiongen_axes_positions(uint32_t axes, const float* from_m, float* out, uint32_t count,
                                        motiongen_error* error) {
  if (from_m == nullptr || out == nullptr) return missing("from_m, out", error);
  const Axes* known = axes_of(axes);
  if (known == nullptr) return unknown_axes(axes, error);
  known->positions({from_m, 3 * std::size_t{count}}, {out, 3 * std::size_t{count}});
  return answer({}, error);
}

motiongen_code motiongen_axes_rotations(uint32_t axes, const float* from_wxyz, float* out_xyzw, uint32_t count,
                                        motiongen_error* error) {
  if (from_wxyz == nullptr || out_xyzw == nullptr) return missing("from_wxyz, out_xyzw", error);
  const Axes* known = axes_of(axes);
  if (known == nullptr) return unknown_axes(axes, error);
  known->quaternions_xyzw({from_wxyz, 4 * std::size_t{count}}, {out_xyzw, 4 * std::size_t{count}});
  return answer({}, error);
}
