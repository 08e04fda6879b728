// What a client says to the server and hears from it, as plain values. Frames count from 0 at the start of a session.
// Texts are UTF-8; others are refused.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "motiongen/client/catalog.hpp"
#include "motiongen/client/targets.hpp"
#include "motiongen/core/frame_format.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

// How much a session matters when the server has to choose.
enum class Priority { hero = 1, near = 2, crowd = 3, batch = 4 };

// A text, a preset of the catalogue by its id, or the vector of a text encoder; one of them. Beside a vector the text
// says, for people, what it means.
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
  std::string rig_id;
  Prompt prompt;
  std::vector<std::pair<std::uint64_t, Prompt>> later_prompts;  // by the frame from which each holds
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
  // What the character did just before frame 0, in place of the start: rows of the rig, whole patches of them.
  std::vector<float> prior_rows;
  // Prompts hold also where targets ask for a pace that they contradict; else the model walks someone who stands.
  bool keep_prompts = false;
  FrameFormat frame_format = FrameFormat::f32;
  std::vector<std::string> outputs;  // of Model::outputs: what each row shall have besides, at Rig::column(name)
  Clock clock = Clock::real_time;
  // Behind the playhead that stay readable, up to TimelineOptions::kMostKept, or kKeepAll; recovery needs 40 or more.
  std::uint32_t keep_frames = 40;
};

// What changes of an open session from the next window on; what is absent stays.
struct OptionsChange {
  std::optional<Priority> priority;
  std::optional<std::uint32_t> lookahead_frames;
  std::optional<std::uint32_t> denoise_steps;
  std::optional<std::uint32_t> history_frames;
  // Of text and of targets, both set anew, absent within it for the model's own.
  std::optional<std::pair<std::optional<float>, std::optional<float>>> guidance;
};

// The number of an edit, in the order of the calls of its session; rises, and stays valid over a loss of the stream.
using EditId = std::uint64_t;

// What was taken although the model was not trained for it.
struct Warning {
  std::string reason;  // PROMPT_OUTSIDE_DOMAIN, UNTRAINED_CONSTRAINT, UNTRAINED_SPEED
  std::string message;
  std::string field;
};

struct ServiceLevel {
  std::uint32_t tier = 1;  // 1 full, 2 fewer steps, 3 no guidance, 5 holds its pose
  std::uint32_t denoise_steps = 0;
};

// Where a target was put that left that to the server.
struct Placement {
  std::uint32_t target = 0;  // its id
  std::uint64_t first_frame = 0;
  std::uint64_t last_frame = 0;
  std::uint64_t arrival_frame = 0;  // the one that is aimed for, between the two at which it may be met
  std::uint64_t anchor_frame = 0;   // at which it takes effect
  float anchor_x_m = 0;             // the character just before
  float anchor_z_m = 0;
  float anchor_heading_rad = 0;
};

// What the server chose for a session.
struct Opened {
  std::string session_id;  // unique among all servers; in their traces
  std::string model_id;
  std::string rig_id;
  std::uint64_t seed = 0;
  std::uint32_t lookahead_frames = 0;
  std::uint32_t committed_horizon_frames = 0;
  std::uint32_t denoise_steps = 0;
  std::vector<Warning> warnings;
  std::vector<Placement> placements;
};

// A server that has room where another has none: by its address, or by a routing key through the proxy that is used
// already.
struct OtherServer {
  std::string address;
  std::string routing_key;
};

// The answer to an edit. `status` is OK or the server's refusal, whose reasons docs/protocol.md lists.
struct Outcome {
  Status status;
  std::optional<std::uint64_t> effective_frame;  // the first that it shows at; absent when it alters no frame
  std::string field;                             // at fault, where one is
  std::string allowed;                           // there
  std::optional<double> retry_after_s;           // after which the same would be taken
  std::vector<OtherServer> other_servers;        // with room for a session that was refused, the best first
  std::vector<Warning> warnings;
  std::vector<Placement> placements;
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
  durability,       // whether another server could go on with the session has changed: `is_durable`
};

struct Event {
  EventKind kind = EventKind::opened;
  std::uint32_t session = 0;  // Session::id; 0: about the connection
  EditId edit = 0;
  Outcome outcome;
  ServiceLevel level;
  std::uint64_t frame = 0;
  bool exact = false;
  bool is_durable = false;
  Reached reached;
};

}  // namespace motiongen
