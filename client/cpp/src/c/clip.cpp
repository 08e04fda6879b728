// The C interface of clips.
#include <utility>

#include "c/handles.hpp"
#include "c/structs.hpp"
#include "c/values.hpp"

using motiongen::c::answer;
using motiongen::c::missing;
using motiongen::c::text;

namespace {

const motiongen::Clip* sample_of(const motiongen_clip* clip, uint32_t sample) {
  return clip != nullptr && sample < clip->samples.size() ? &clip->samples[sample] : nullptr;
}

}  // namespace

motiongen_code motiongen_client_generate_clip(motiongen_client* client, const motiongen_clip_options* options,
                                              motiongen_clip** clip, motiongen_error* error) {
  motiongen_clip_options given;
  if (client == nullptr || clip == nullptr) return missing("client, clip", error);
  *clip = nullptr;
  if (!motiongen::c::read(options, given)) return missing("options", error);
  if (given.num_waypoints > 0 && given.waypoints == nullptr) return missing("waypoints", error);
  if (given.num_targets > 0 && given.targets == nullptr) return missing("targets", error);
  motiongen::ClipOptions chosen;
  chosen.num_frames = given.num_frames;
  if (given.num_samples != 0) chosen.num_samples = given.num_samples;
  chosen.prompt = motiongen::Prompt(text(given.prompt));
  chosen.model_id = text(given.model_id);
  if (given.has_seed != 0) chosen.seed = given.seed;
  chosen.denoise_steps = given.denoise_steps;
  if (given.timeout_s != 0) chosen.timeout_s = given.timeout_s;
  chosen.start_x_m = given.start_x_m;
  chosen.start_z_m = given.start_z_m;
  if (given.start_heading_rad != 0) chosen.start_heading_rad = given.start_heading_rad;
  for (uint32_t index = 0; index < given.num_waypoints; ++index) {
    const motiongen_waypoint& each = given.waypoints[index];
    motiongen::Waypoint waypoint;
    waypoint.frame = each.frame;
    waypoint.x_m = each.x_m;
    waypoint.z_m = each.z_m;
    if (each.has_heading != 0) waypoint.heading_rad = each.heading_rad;
    chosen.targets.emplace_back(waypoint);
  }
  for (uint32_t index = 0; index < given.num_targets; ++index) {
    auto target = motiongen::c::target_of(given.targets[index]);
    if (!target) return answer(target.status(), error);
    chosen.targets.push_back(std::move(target).value());
  }
  auto made = client->client.generate_clip(chosen);
  if (!made) return answer(made.status(), error);
  *clip = new motiongen_clip{std::move(made).value()};
  return answer({}, error);
}

void motiongen_clip_destroy(motiongen_clip* clip) { delete clip; }

uint32_t motiongen_clip_num_samples(const motiongen_clip* clip) {
  return clip == nullptr ? 0 : static_cast<uint32_t>(clip->samples.size());
}

uint32_t motiongen_clip_num_frames(const motiongen_clip* clip) {
  const motiongen::Clip* first = sample_of(clip, 0);
  return first == nullptr ? 0 : first->num_frames;
}

const float* motiongen_clip_rows(const motiongen_clip* clip, uint32_t sample, uint32_t* row_floats) {
  const motiongen::Clip* found = sample_of(clip, sample);
  if (found == nullptr) return nullptr;
  if (row_floats != nullptr) *row_floats = static_cast<uint32_t>(found->rows.size() / found->num_frames);
  return found->rows.data();
}

uint64_t motiongen_clip_seed(const motiongen_clip* clip, uint32_t sample) {
  const motiongen::Clip* found = sample_of(clip, sample);
  return found == nullptr ? 0 : found->opened.seed;
}

motiongen_code motiongen_clip_residual(const motiongen_clip* clip, uint32_t sample, uint32_t target,
                                       motiongen_residual* residual, motiongen_error* error) {
  const motiongen::Clip* found = sample_of(clip, sample);
  if (found == nullptr || !motiongen::c::has_size(residual)) return missing("clip, sample, residual", error);
  if (target >= found->residuals.size()) {
    return answer(
        motiongen::invalid("target", std::to_string(target), "less than " + std::to_string(found->residuals.size())),
        error);
  }
  const motiongen::Residual& measured = found->residuals[target];
  motiongen_residual told;
  std::memset(&told, 0, sizeof told);
  told.num_frames = measured.num_frames;
  told.met = measured.met ? 1 : 0;
  told.has_position = measured.position_m ? 1 : 0;
  told.position_m = measured.position_m.value_or(motiongen::Deviation()).worst;
  told.has_heading = measured.heading_rad ? 1 : 0;
  told.heading_rad = measured.heading_rad.value_or(motiongen::Deviation()).worst;
  told.has_rotation = measured.rotation_rad ? 1 : 0;
  told.rotation_rad = measured.rotation_rad.value_or(motiongen::Deviation()).worst;
  motiongen::c::write(told, residual);
  return answer({}, error);
}
