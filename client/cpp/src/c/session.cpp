// The C interface of a session.
#include "c/handles.hpp"
#include "c/structs.hpp"
#include "motiongen/core/pose.hpp"

using motiongen::c::answer;
using motiongen::c::missing;
using motiongen::c::not_open;

void motiongen_session_destroy(motiongen_session* session) { delete session; }

uint32_t motiongen_session_id(const motiongen_session* session) {
  return session == nullptr ? 0 : session->session.id();
}

int32_t motiongen_session_is_open(const motiongen_session* session) {
  return session != nullptr && session->session.is_open() ? 1 : 0;
}

motiongen_code motiongen_session_wait_open(motiongen_session* session, double timeout_s, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return answer(session->session.wait_open(timeout_s).status(), error);
}

// ---- its rig

motiongen_code motiongen_session_rig(const motiongen_session* session, motiongen_rig* rig, motiongen_error* error) {
  if (session == nullptr || !motiongen::c::has_size(rig)) return missing("session, rig", error);
  const motiongen::Rig& known = session->session.rig();
  if (known.num_joints() == 0) return answer(not_open(), error);
  motiongen_rig told;
  std::memset(&told, 0, sizeof told);
  told.num_joints = known.num_joints();
  told.row_floats = known.row_width;
  told.frame_rate_hz = known.frame_rate_hz;
  told.root_column = known.root_column;
  told.rotation_column = known.rotation_column;
  told.contact_column = known.contact_column;
  motiongen::c::write(told, rig);
  return answer({}, error);
}

motiongen_code motiongen_session_block(const motiongen_session* session, const char* name, uint32_t* column,
                                       motiongen_error* error) {
  if (session == nullptr || name == nullptr || column == nullptr) return missing("session, name, column", error);
  const auto found = session->session.rig().column(name);
  if (found) *column = found.value();
  return answer(found.status(), error);
}

const char* motiongen_session_joint_name(const motiongen_session* session, uint32_t joint) {
  if (session == nullptr || joint >= session->session.rig().num_joints()) return nullptr;
  return session->session.rig().joint_names[joint].c_str();
}

int32_t motiongen_session_joint_parent(const motiongen_session* session, uint32_t joint) {
  if (session == nullptr || joint >= session->session.rig().num_joints()) return -1;
  return session->session.rig().parents[joint];
}

// ---- frames

int32_t motiongen_session_sample(motiongen_session* session, float* row, uint32_t row_floats) {
  return session != nullptr && row != nullptr && session->session.sample({row, row_floats}) ? 1 : 0;
}

motiongen_code motiongen_session_copy_frame(const motiongen_session* session, uint64_t frame, float* row,
                                            uint32_t row_floats, motiongen_error* error) {
  if (session == nullptr || row == nullptr) return missing("session, row", error);
  return answer(session->session.copy_frame(frame, {row, row_floats}), error);
}

motiongen_code motiongen_session_wait_frame(motiongen_session* session, uint64_t frame, double timeout_s,
                                            motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return answer(session->session.wait_frame(frame, timeout_s), error);
}

motiongen_code motiongen_session_advance_to(motiongen_session* session, uint64_t frame, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return answer(session->session.advance_to(frame), error);
}

motiongen_code motiongen_session_joint_positions(const motiongen_session* session, const float* row, float* positions_m,
                                                 uint32_t num_floats, motiongen_error* error) {
  if (session == nullptr || row == nullptr || positions_m == nullptr)
    return missing("session, row, positions_m", error);
  const motiongen::Rig& rig = session->session.rig();
  if (rig.num_joints() == 0) return answer(not_open(), error);
  if (num_floats < 3 * rig.num_joints()) {
    return answer(
        motiongen::invalid("num_floats", std::to_string(num_floats), std::to_string(3 * rig.num_joints()) + " or more"),
        error);
  }
  motiongen::joint_positions(rig, {row, rig.row_width}, {positions_m, num_floats});
  return answer({}, error);
}

motiongen_code motiongen_session_set_time_scale(motiongen_session* session, double scale, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return answer(session->session.set_time_scale(scale), error);
}

int32_t motiongen_session_is_durable(const motiongen_session* session) {
  return session != nullptr && session->session.is_durable() ? 1 : 0;
}

uint64_t motiongen_session_playhead(const motiongen_session* session) {
  return session == nullptr ? 0 : session->session.playhead();
}

uint64_t motiongen_session_buffered_to(const motiongen_session* session) {
  return session == nullptr ? 0 : session->session.buffered_to();
}

uint32_t motiongen_session_underruns(const motiongen_session* session) {
  return session == nullptr ? 0 : session->session.stats().underruns;
}
