#include "client/convert.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "client/outbox.hpp"
#include "client/texts.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen::convert {
namespace {

constexpr char kGuidance[] = "a finite number, or none for the model's";
// What is kept of an answer, far above what honest servers send.
constexpr std::size_t kMostTextBytes = 4096;  // of each text
constexpr std::size_t kMostWarnings = 64;
constexpr int kMostPlacements = 16384;
constexpr std::size_t kMostOtherServers = 3;  // as in the contract; each of them may be called in turn

Code code_of(int number) {
  return number >= 0 && number <= static_cast<int>(Code::unauthenticated) ? static_cast<Code>(number) : Code::unknown;
}

// What is kept of a text from the server, and how much is not.
std::string kept(const std::string& text) {
  if (text.size() <= kMostTextBytes) return text;
  const std::string first = first_bytes(text, kMostTextBytes);
  return first + "... (" + std::to_string(text.size() - first.size()) + " more bytes were left out)";
}

template <class Messages>
std::vector<Warning> warnings(const Messages& messages) {
  std::vector<Warning> found;
  for (const auto& each : messages) {
    if (found.size() == kMostWarnings) {
      const std::size_t left_out = static_cast<std::size_t>(messages.size()) - kMostWarnings;
      found.push_back({"WARNINGS_LEFT_OUT", std::to_string(left_out) + " more warnings came than are kept", ""});
      break;
    }
    found.push_back({kept(each.reason()), kept(each.message()), kept(each.field())});
  }
  return found;
}

template <class Messages>
std::vector<Placement> placements(const Messages& messages) {
  std::vector<Placement> found;
  for (const auto& each : messages) {
    Placement made;
    made.target = each.constraint_id();
    made.first_frame = each.first_frame();
    made.last_frame = each.last_frame();
    made.arrival_frame = each.arrival_frame();
    made.anchor_frame = each.anchor_frame();
    made.anchor_x_m = each.anchor_x();
    made.anchor_z_m = each.anchor_z();
    made.anchor_heading_rad = each.anchor_heading();
    found.push_back(made);
  }
  return found;
}

Status check_finite(const char* field, std::optional<float> given, const char* allowed) {
  if (!given || std::isfinite(*given)) return {};
  return invalid(field, std::to_string(*given), allowed);
}

Status check_numbers(const SessionOptions& options) {
  Status checked = check_finite("start_x_m", options.start_x_m, "finite metres");
  if (checked) checked = check_finite("start_z_m", options.start_z_m, "finite metres");
  if (checked) checked = check_finite("start_heading_rad", options.start_heading_rad, "finite radians, or none");
  if (checked) checked = check_finite("text_guidance", options.text_guidance, kGuidance);
  return checked ? check_finite("constraint_guidance", options.constraint_guidance, kGuidance) : checked;
}

}  // namespace

bool all_finite(Span<const float> values) {
  return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

Status check(const Prompt& prompt) {
  if (prompt.empty()) {
    return invalid("prompt", "nothing", "a text, a preset or an embedding; remove_prompt takes one away");
  }
  if (!prompt.preset_id.empty() && !(prompt.text.empty() && prompt.embedding.empty())) {
    return invalid("prompt", "a preset and something else", "one of them");
  }
  if (!all_finite(prompt.embedding))
    return invalid("Prompt::embedding", "a number that is not finite", "finite numbers");
  Status checked = check_utf8("Prompt::text", prompt.text);
  if (checked) checked = check_utf8("Prompt::preset_id", prompt.preset_id);
  return checked ? check_utf8("Prompt::text_encoder", prompt.text_encoder) : checked;
}

Status check(const SessionOptions& options) {
  Status checked = check_numbers(options);
  if (checked) checked = check_utf8("model_id", options.model_id);
  if (checked) checked = check_utf8("rig_id", options.rig_id);
  for (const std::string& each : options.outputs) {
    if (checked) checked = check_utf8("outputs", each);
  }
  if (checked && !options.prompt.empty()) checked = check(options.prompt);
  for (const auto& each : options.later_prompts) {
    if (checked) checked = check(each.second);
  }
  for (const Target& target : options.targets) {
    if (checked) checked = check(target);
  }
  const bool keeps_all = options.keep_frames == TimelineOptions::kKeepAll;
  if (checked && options.keep_frames > TimelineOptions::kMostKept && !keeps_all) {
    checked = invalid("keep_frames", std::to_string(options.keep_frames),
                      "up to " + std::to_string(TimelineOptions::kMostKept) + ", or TimelineOptions::kKeepAll");
  }
  return checked;
}

Status check(const OptionsChange& change) {
  if (!change.guidance) return {};
  Status checked = check_finite("guidance, of text", change.guidance->first, kGuidance);
  return checked ? check_finite("guidance, of targets", change.guidance->second, kGuidance) : checked;
}

Status check_placements(int count) {
  if (count <= kMostPlacements) return {};
  return violation("an answer has " + std::to_string(count) + " placements; at most " +
                   std::to_string(kMostPlacements) + " are kept");
}

Status check_size(const char* what, const google::protobuf::MessageLite& message, const Limits& limits) {
  const std::size_t most = Outbox::most_event_bytes(limits.max_request_bytes);
  const std::size_t given = message.ByteSizeLong();
  if (given <= most) return {};
  return invalid(what, std::to_string(given) + " bytes", "at most " + std::to_string(most) + " in one event; split it");
}

Status check_rows(Span<const float> rows, std::uint32_t row_width) {
  const bool fits = row_width > 0 && !rows.empty() && rows.size() % row_width == 0;
  if (fits && all_finite(rows)) return {};
  if (fits) return invalid("rows", "a number that is not finite", "finite numbers");
  return invalid("rows", std::to_string(rows.size()) + " floats",
                 "whole rows of " + std::to_string(row_width) + " floats, one or more");
}

v1::PromptSpan span(std::uint32_t id, const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame) {
  v1::PromptSpan message;
  message.set_prompt_id(id);
  message.set_start_frame(start_frame);
  message.set_end_frame(end_frame);
  message.set_text(prompt.text);
  message.set_preset_id(prompt.preset_id);
  if (!prompt.embedding.empty()) {
    auto* embedding = message.mutable_embedding();
    embedding->set_text_encoder(prompt.text_encoder);
    embedding->mutable_values()->Add(prompt.embedding.begin(), prompt.embedding.end());
  }
  return message;
}

v1::OpenSession open_session(const SessionOptions& options) {
  v1::OpenSession message;
  message.set_model_id(options.model_id);
  message.set_rig_id(options.rig_id);
  if (options.seed) message.set_seed(*options.seed);
  message.set_priority(static_cast<v1::PriorityClass>(options.priority));
  message.set_lookahead_frames(options.lookahead_frames);
  message.set_scalar_type(static_cast<v1::ScalarType>(options.frame_format));
  message.set_keep_prompts(options.keep_prompts);
  for (const std::string& each : options.outputs) message.add_outputs(each);
  if (options.denoise_steps != 0) message.set_denoise_steps(options.denoise_steps);
  if (options.history_frames != 0) message.set_history_frames(options.history_frames);
  if (options.text_guidance) message.mutable_guidance()->set_text(*options.text_guidance);
  if (options.constraint_guidance) message.mutable_guidance()->set_constraint(*options.constraint_guidance);
  if (options.start_x_m != 0 || options.start_z_m != 0 || options.start_heading_rad) {
    auto* pose = message.mutable_start_pose();
    pose->set_x(options.start_x_m);
    pose->set_z(options.start_z_m);
    if (options.start_heading_rad) pose->set_heading(*options.start_heading_rad);
  }
  return message;
}

void set_rows(Span<const float> rows, const Rig& rig, v1::FrameChunk* frames) {
  frames->set_frame_count(static_cast<std::uint32_t>(rows.size() / rig.row_width));
  frames->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
  for (std::size_t row = 0; row + rig.row_width <= rows.size(); row += rig.row_width) {
    frames->mutable_data()->append(reinterpret_cast<const char*>(&rows[row]), rig.own_width * sizeof(float));
  }
}

v1::SetOptions set_options(const OptionsChange& change) {
  v1::SetOptions message;
  if (change.priority) message.set_priority(static_cast<v1::PriorityClass>(*change.priority));
  if (change.lookahead_frames) message.set_lookahead_frames(*change.lookahead_frames);
  if (change.denoise_steps) message.set_denoise_steps(*change.denoise_steps);
  if (change.history_frames) message.set_history_frames(*change.history_frames);
  if (change.guidance) {
    auto* guidance = message.mutable_guidance();
    if (change.guidance->first) guidance->set_text(*change.guidance->first);
    if (change.guidance->second) guidance->set_constraint(*change.guidance->second);
  }
  return message;
}

Opened opened(const v1::SessionOpened& message) {
  Opened made;
  made.session_id = kept(message.session_id());
  made.model_id = kept(message.model_id());
  made.rig_id = kept(message.rig_id());
  made.seed = message.seed();
  made.lookahead_frames = message.lookahead_frames();
  made.committed_horizon_frames = message.committed_horizon_frames();
  made.denoise_steps = message.denoise_steps();
  made.warnings = warnings(message.warnings());
  made.placements = placements(message.placements());
  return made;
}

std::vector<OtherServer> other_servers(const google::protobuf::RepeatedPtrField<v1::OtherServer>& messages) {
  std::vector<OtherServer> made;
  for (const v1::OtherServer& each : messages) {
    if (made.size() == kMostOtherServers) break;
    made.push_back({kept(each.address()), kept(each.routing_key())});
  }
  return made;
}

Outcome outcome(const v1::EditOutcome& message) {
  Outcome made;
  if (message.code() != 0)
    made.status = Status(code_of(message.code()), kept(message.reason()), kept(message.message()));
  if (message.has_effective_frame()) made.effective_frame = message.effective_frame();
  made.field = kept(message.field());
  made.allowed = kept(message.allowed());
  if (message.has_retry_after()) made.retry_after_s = seconds(message.retry_after());
  made.warnings = warnings(message.warnings());
  made.placements = placements(message.placements());
  made.other_servers = other_servers(message.other_servers());
  return made;
}

Reached reached(const v1::ConstraintReached& message) {
  Reached made;
  made.target = message.constraint_id();
  made.met = message.met();
  made.frame = message.frame();
  if (message.has_position_error_m()) made.position_error_m = message.position_error_m();
  if (message.has_rotation_error_rad()) made.rotation_error_rad = message.rotation_error_rad();
  return made;
}

Residual residual(const v1::ConstraintResidual& message) {
  const auto deviation = [](const v1::Deviation& each) { return Deviation{each.mean(), each.worst()}; };
  Residual made;
  made.num_frames = message.frame_count();
  if (message.has_position_m()) made.position_m = deviation(message.position_m());
  if (message.has_heading_rad()) made.heading_rad = deviation(message.heading_rad());
  if (message.has_rotation_rad()) made.rotation_rad = deviation(message.rotation_rad());
  made.met = message.met();
  return made;
}

Status closed(const v1::SessionClosed& message) {
  std::string reason = v1::CloseReason_Name(message.reason());
  const std::string prefix = "CLOSE_REASON_";
  reason = reason.empty() ? "UNSPECIFIED" : reason.substr(prefix.size());
  const Code code = message.code() == 0 ? Code::aborted : code_of(message.code());
  return {code, reason, message.message().empty() ? "the server ended the session" : kept(message.message())};
}

double seconds(const google::protobuf::Duration& duration) {
  return static_cast<double>(duration.seconds()) + duration.nanos() / 1e9;
}

void set_seconds(double seconds, google::protobuf::Duration* duration) {
  const double whole = std::floor(seconds);
  duration->set_seconds(static_cast<std::int64_t>(whole));
  duration->set_nanos(static_cast<std::int32_t>((seconds - whole) * 1e9));
}

}  // namespace motiongen::convert
