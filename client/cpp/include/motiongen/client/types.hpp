// What a client says to the server and hears from it, as plain values. Frames count from 0 at the start of a session.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "motiongen/client/targets.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

// How much a session matters when the server has to choose.
enum class Priority { hero = 1, near = 2, crowd = 3, batch = 4 };

// A text, a preset of the catalogue by its id, or the vector of a text encoder; one of them.
struct Prompt {
  std::string text;
  std::string preset_id;
  std::string text_encoder;
  std::vector<float> embedding;

  Prompt() = default;
  Prompt(std::string given) : text(std::move(given)) {}  // NOLINT: converts on purpose
  Prompt(const char* given) : text(given) {}             // NOLINT: converts on purpose
  static Prompt preset(std::string id) {
    Prompt prompt;
    prompt.preset_id = std::move(id);
    return prompt;
  }
  bool empty() const { return text.empty() && preset_id.empty() && embedding.empty(); }
};

// Whose clock moves a playhead: the library's, in real time, or the caller's, by `Session::advance_to`.
enum class Clock { real_time, manual };

// What a session is opened with; what is empty, absent or 0 is left to the server.
struct SessionOptions {
  std::string model_id;
  Prompt prompt;
  std::vector<Target> targets;
  std::optional<std::uint64_t> seed;
  Priority priority = Priority::near;
  std::uint32_t lookahead_frames = 0;
  std::uint32_t denoise_steps = 0;
  std::uint32_t history_frames = 0;
  std::optional<float> text_guidance;
  std::optional<float> constraint_guidance;
  float start_x_m = 0;
  float start_z_m = 0;
  std::optional<float> start_heading_rad;
  Clock clock = Clock::real_time;
  std::uint32_t keep_frames = 40;  // behind the playhead that stay readable; recovery needs 40 or more
};

// The number of an edit, in the order of the calls of its session; rises, and stays valid over a loss of the stream.
using EditId = std::uint64_t;

// What was taken although the model was not trained for it.
struct Warning {
  std::string reason;  // PROMPT_OUTSIDE_DOMAIN, UNTRAINED_CONSTRAINT
  std::string message;
  std::string field;
};

struct ServiceLevel {
  std::uint32_t tier = 1;  // 1 full, 2 fewer steps, 3 no guidance, 5 holds its pose
  std::uint32_t denoise_steps = 0;
};

// What the server chose for a session.
struct Opened {
  std::string session_id;  // in the server's logs
  std::string model_id;
  std::string rig_id;
  std::uint64_t seed = 0;
  std::uint32_t lookahead_frames = 0;
  std::uint32_t committed_horizon_frames = 0;
  std::uint32_t denoise_steps = 0;
  std::vector<Warning> warnings;
};

// The answer to an edit. `status` is OK or the server's refusal, whose reasons docs/protocol.md lists.
struct Outcome {
  Status status;
  std::optional<std::uint64_t> effective_frame;  // the first that it shows at; absent when it alters no frame
  std::string field;                             // at fault, where one is
  std::string allowed;                           // there
  std::optional<double> retry_after_s;           // after which the same would be taken
  std::vector<Warning> warnings;
};

// What became of a target, told when its last frame can change no more.
struct Reached {
  std::uint32_t target = 0;               // its id
  bool met = false;                       // within its tolerances
  std::uint64_t frame = 0;                // at which it was measured
  std::optional<float> position_error_m;  // absent: not asked for
  std::optional<float> rotation_error_rad;
};

enum class EventKind {
  opened,           // of a session
  edit,             // was answered: `edit`, `outcome`
  service_level,    // changed: `level`
  closed,           // of a session that the server ended, refused or could not recover: `outcome.status` says why
  connection_lost,  // sessions play what they hold while the client connects again: `outcome.status`
  connected,        // again
  recovered,        // a session goes on: `exact`, and `frame`, from which on its motion is new where it is not
  draining,         // the server will end the stream: opens are refused, sessions go on until then
  reached,          // a target was met or missed: `reached`
};

struct Event {
  EventKind kind = EventKind::opened;
  std::uint32_t session = 0;  // Session::id; 0: about the connection
  EditId edit = 0;
  Outcome outcome;
  ServiceLevel level;
  std::uint64_t frame = 0;
  bool exact = false;
  Reached reached;
};

struct Model {
  std::string model_id;
  std::string rig_id;
  std::string licence;
  std::string text_encoder;
  std::uint32_t horizon_frames = 0;
  std::uint32_t patch_frames = 0;
  std::uint32_t default_denoise_steps = 0;
  std::uint32_t min_denoise_steps = 0;
  std::uint32_t max_denoise_steps = 0;
  std::uint32_t max_history_frames = 0;
  std::vector<std::string> preset_ids;
};

struct Limits {
  std::uint32_t max_sessions_per_stream = 0;
  std::uint32_t max_lookahead_frames = 0;
  std::uint32_t default_lookahead_frames = 0;
  std::uint32_t max_trajectory_frames = 0;
  std::uint32_t max_request_bytes = 0;
  std::uint32_t max_hold_frames = 0;
  float max_speed_mps = 0;
  std::uint32_t max_clip_frames = 0;
  std::uint32_t max_clip_samples = 0;
};

// What a server offers; models[0] is its default.
struct Catalog {
  std::string etag;
  std::vector<Rig> rigs;
  std::vector<Model> models;
  Limits limits;
};

}  // namespace motiongen
