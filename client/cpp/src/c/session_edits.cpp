// The C interface of a session's edits.
#include <optional>
#include <vector>

#include "c/handles.hpp"
#include "c/structs.hpp"
#include "c/values.hpp"

using motiongen::EditId;
using motiongen::Result;
using motiongen::Target;
using motiongen::c::answer;
using motiongen::c::missing;

namespace {

motiongen_code tell(const Result<EditId>& sent, uint64_t* edit, motiongen_error* error) {
  if (sent && edit != nullptr) *edit = sent.value();
  return answer(sent.status(), error);
}

motiongen_code add(motiongen_session* session, const Target& target, uint32_t* id, uint64_t* edit,
                   motiongen_error* error) {
  std::vector<std::uint32_t> ids;
  const auto sent = session->session.add_targets({&target, 1}, &ids);
  if (sent && id != nullptr) *id = ids[0];
  return tell(sent, edit, error);
}

std::optional<float> optional_of(const float* value) {
  return value == nullptr ? std::nullopt : std::optional<float>(*value);
}

}  // namespace

motiongen_code motiongen_session_set_prompt(motiongen_session* session, const char* text, uint64_t* edit,
                                            motiongen_error* error) {
  if (session == nullptr || text == nullptr) return missing("session, text", error);
  return tell(session->session.set_prompt(motiongen::Prompt(text)), edit, error);
}

motiongen_code motiongen_session_add_waypoint(motiongen_session* session, uint64_t frame, float x_m, float z_m,
                                              const float* heading_rad, uint32_t* id, uint64_t* edit,
                                              motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return add(session, motiongen::Waypoint{frame, x_m, z_m, optional_of(heading_rad), {}}, id, edit, error);
}

motiongen_code motiongen_session_add_path(motiongen_session* session, uint64_t first_frame, const float* positions_m,
                                          uint32_t num_frames, uint32_t* id, uint64_t* edit, motiongen_error* error) {
  if (session == nullptr || positions_m == nullptr) return missing("session, positions_m", error);
  motiongen::RootTrajectory path;
  path.first_frame = first_frame;
  path.positions_m.assign(positions_m, positions_m + 2 * std::size_t{num_frames});
  return add(session, path, id, edit, error);
}

motiongen_code motiongen_session_remove_target(motiongen_session* session, uint32_t id, uint64_t* edit,
                                               motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.remove_targets({&id, 1}), edit, error);
}

motiongen_code motiongen_session_clear_targets(motiongen_session* session, uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.set_targets({}), edit, error);
}

motiongen_code motiongen_session_set_velocity(motiongen_session* session, float x_mps, float z_mps, double seconds,
                                              const float* heading_rad, int32_t keep_prompt, uint64_t* edit,
                                              motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto sent = session->session.set_velocity(x_mps, z_mps, seconds, optional_of(heading_rad), keep_prompt != 0);
  return tell(sent, edit, error);
}

motiongen_code motiongen_session_pause(motiongen_session* session, uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.pause(), edit, error);
}

motiongen_code motiongen_session_resume(motiongen_session* session, uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.resume(), edit, error);
}

motiongen_code motiongen_session_schedule_prompt(motiongen_session* session, const motiongen_prompt* prompt,
                                                 uint64_t start_frame, uint64_t end_frame, uint32_t* id, uint64_t* edit,
                                                 motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto given = motiongen::c::prompt_of(prompt);
  if (!given) return answer(given.status(), error);
  return tell(session->session.schedule_prompt(given.value(), start_frame, end_frame, id), edit, error);
}

motiongen_code motiongen_session_replace_prompt(motiongen_session* session, uint32_t id, const motiongen_prompt* prompt,
                                                uint64_t start_frame, uint64_t end_frame, uint64_t* edit,
                                                motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto given = motiongen::c::prompt_of(prompt);
  if (!given) return answer(given.status(), error);
  return tell(session->session.replace_prompt(id, given.value(), start_frame, end_frame), edit, error);
}

motiongen_code motiongen_session_remove_prompt(motiongen_session* session, uint32_t id, uint64_t* edit,
                                               motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.remove_prompt(id), edit, error);
}

motiongen_code motiongen_session_add_target(motiongen_session* session, const motiongen_target* target, uint32_t* id,
                                            uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto given = motiongen::c::target_of(target);
  if (!given) return answer(given.status(), error);
  return add(session, given.value(), id, edit, error);
}

motiongen_code motiongen_session_replace_target(motiongen_session* session, uint32_t id, const motiongen_target* target,
                                                uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto given = motiongen::c::target_of(target);
  if (!given) return answer(given.status(), error);
  return tell(session->session.replace_target(id, given.value()), edit, error);
}

motiongen_code motiongen_session_placement(const motiongen_session* session, uint32_t target,
                                           motiongen_placement* placement, motiongen_error* error) {
  if (session == nullptr || !motiongen::c::has_size(placement)) return missing("session, placement", error);
  const auto found = session->session.placement(target);
  if (!found) {
    return answer({motiongen::Code::not_found, "NOT_PLACED",
                   "target " + std::to_string(target) + " was not put anywhere by the server, or not yet"},
                  error);
  }
  motiongen_placement told;
  std::memset(&told, 0, sizeof told);
  told.target = found->target;
  told.first_frame = found->first_frame;
  told.last_frame = found->last_frame;
  told.arrival_frame = found->arrival_frame;
  told.anchor_frame = found->anchor_frame;
  told.anchor_x_m = found->anchor_x_m;
  told.anchor_z_m = found->anchor_z_m;
  told.anchor_heading_rad = found->anchor_heading_rad;
  motiongen::c::write(told, placement);
  return answer({}, error);
}

motiongen_code motiongen_session_go_to(motiongen_session* session, float x_m, float z_m, const float* heading_rad,
                                       int32_t relative, uint32_t* id, uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.go_to(x_m, z_m, optional_of(heading_rad), relative != 0, id), edit, error);
}

motiongen_code motiongen_session_teleport(motiongen_session* session, float x_m, float z_m, float heading_rad,
                                          uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.teleport(x_m, z_m, heading_rad), edit, error);
}

motiongen_code motiongen_session_cut_to(motiongen_session* session, const float* rows, uint32_t num_rows,
                                        uint64_t* edit, motiongen_error* error) {
  if (session == nullptr || rows == nullptr) return missing("session, rows", error);
  const std::size_t width = session->session.rig().row_width;
  return tell(session->session.cut_to({rows, width * num_rows}), edit, error);
}

motiongen_code motiongen_session_seek(motiongen_session* session, uint64_t frame, uint64_t* edit,
                                      motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  return tell(session->session.seek(frame), edit, error);
}

motiongen_code motiongen_session_set_options(motiongen_session* session, const motiongen_options_change* change,
                                             uint64_t* edit, motiongen_error* error) {
  if (session == nullptr) return missing("session", error);
  const auto given = motiongen::c::change_of(change);
  if (!given) return answer(given.status(), error);
  return tell(session->session.set_options(given.value()), edit, error);
}
