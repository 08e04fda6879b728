// The C interface of the ground.
#include <utility>

#include "c/handles.hpp"
#include "c/structs.hpp"

using motiongen::c::answer;
using motiongen::c::missing;

motiongen_code motiongen_ground_create(const motiongen_session* session, motiongen_heights heights, void* context,
                                       motiongen_ground** ground, motiongen_error* error) {
  if (session == nullptr || heights == nullptr || ground == nullptr) return missing("session, heights, ground", error);
  *ground = nullptr;
  const motiongen::Rig& rig = session->session.rig();
  if (rig.num_joints() == 0) return answer(motiongen::c::not_open(), error);
  auto made =
      motiongen::Ground::make(rig, [heights, context](double x_m, double z_m) { return heights(context, x_m, z_m); });
  if (!made) return answer(made.status(), error);
  *ground = new motiongen_ground{motiongen::GroundFollower(std::move(made).value()), {}};
  return answer({}, error);
}

void motiongen_ground_destroy(motiongen_ground* ground) { delete ground; }

int32_t motiongen_session_sample_on_ground(motiongen_session* session, motiongen_ground* ground, float* row,
                                           uint32_t row_floats, motiongen_error* error) {
  if (session == nullptr || ground == nullptr || row == nullptr) {
    missing("session, ground, row", error);
    return 0;
  }
  const std::lock_guard<std::mutex> lock(ground->mutex);
  const auto shown = session->session.sample_on_ground(ground->follower, {row, row_floats});
  answer(shown.status(), error);
  return shown && shown.value() ? 1 : 0;
}

motiongen_code motiongen_ground_apply(motiongen_ground* ground, float* rows, uint32_t num_rows,
                                      motiongen_error* error) {
  if (ground == nullptr || rows == nullptr) return missing("ground, rows", error);
  const std::lock_guard<std::mutex> lock(ground->mutex);
  const std::size_t row_floats = ground->follower.rig().row_width;
  return answer(ground->follower.ground().apply({rows, num_rows * row_floats}), error);
}
