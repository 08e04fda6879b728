#include "edits.hpp"

#include <algorithm>
#include <cmath>

namespace motiongen::load {
namespace {

constexpr std::uint32_t kPromptId = 1;
constexpr double kTurnPeriodS = 7;  // the period of a stick swung from side to side
constexpr double kTurnRad = 1.2;
constexpr double kPi = 3.14159265358979323846;

v1::PromptSpan span(const Group& group, std::uint32_t prompt) {
  v1::PromptSpan span;
  span.set_prompt_id(kPromptId);
  span.set_text(group.prompts(static_cast<int>(prompt)));
  return span;
}

// Each character has its own phase.
double phase_rad(std::uint64_t seed) { return static_cast<double>(seed % 1009) / 1009 * 2 * kPi; }

// A winding path at rule.speed_m_s, which replaces the one before.
void put_waypoints(std::uint64_t seed, const Rule& rule, std::uint32_t number, std::uint64_t first, double frame_rate,
                   v1::EditConstraints& edit) {
  edit.set_clear(true);
  const double phase = phase_rad(seed) + number;
  for (std::uint32_t index = 0; index < rule.waypoints(); ++index) {
    const std::uint64_t frame = first + std::uint64_t{index} * rule.spacing_frames();
    const double along_m = rule.speed_m_s() * static_cast<double>(frame) / frame_rate;
    v1::Constraint& constraint = *edit.add_upsert();
    constraint.set_constraint_id(index + 1);
    constraint.set_frame(frame);
    constraint.mutable_waypoint()->set_x(static_cast<float>(0.5 * std::sin(phase + along_m / 2)));
    constraint.mutable_waypoint()->set_z(static_cast<float>(along_m));
  }
}

// The velocity of a stick swung from side to side.
void put_velocity(std::uint64_t seed, const Rule& rule, std::uint32_t number, double frame_rate,
                  v1::SetVelocity& velocity) {
  const double heading = kTurnRad * std::sin(phase_rad(seed) + 2 * kPi * number * rule.every_s() / kTurnPeriodS);
  velocity.set_x(static_cast<float>(rule.speed_m_s() * std::sin(heading)));
  velocity.set_z(static_cast<float>(rule.speed_m_s() * std::cos(heading)));
  velocity.set_heading(static_cast<float>(heading));
  velocity.set_hold_frames(static_cast<std::uint32_t>(std::max(1.0, std::nearbyint(rule.hold_s() * frame_rate))));
}

}  // namespace

v1::SessionEvent open_event(PlayedCharacter& character, const Load& load) {
  v1::SessionEvent event;
  event.set_session(character.handle());
  event.set_event_seq(character.take_seq());
  v1::OpenSession& open = *event.mutable_open();
  open.set_seed(character.plan().seed());
  open.set_priority(static_cast<v1::PriorityClass>(character.group().priority()));
  open.set_scalar_type(v1::SCALAR_TYPE_F32_LE);
  if (load.has_denoise_steps()) open.set_denoise_steps(load.denoise_steps());
  *open.add_prompts() = span(character.group(), character.plan().prompt());
  return event;
}

v1::SessionEvent edit_event(PlayedCharacter& character, const Load& load, const Rule& rule, std::uint32_t value,
                            double intended_s, double now_s) {
  v1::SessionEvent event;
  event.set_session(character.handle());
  event.set_event_seq(character.take_seq(intended_s));
  const double frame_rate = load.frame_rate();
  if (rule.kind() == "prompt") {
    *event.mutable_edit_prompts()->add_upsert() = span(character.group(), value);
  } else if (rule.kind() == "constraints") {
    const std::uint64_t playhead = character.started() ? character.playhead(now_s) : 0;
    const auto ahead = static_cast<std::uint64_t>(std::nearbyint(rule.ahead_s() * frame_rate));
    const std::uint64_t first = std::max(playhead + ahead, character.committed_to() + load.patch_frames());
    put_waypoints(character.plan().seed(), rule, value, first, frame_rate, *event.mutable_edit_constraints());
  } else {
    put_velocity(character.plan().seed(), rule, value, frame_rate, *event.mutable_set_velocity());
  }
  return event;
}

v1::SessionEvent close_event(PlayedCharacter& character) {
  v1::SessionEvent event;
  event.set_session(character.handle());
  event.set_event_seq(character.take_seq());
  event.mutable_close();
  return event;
}

}  // namespace motiongen::load
