// What the client tells the server and receives from it, as plain values. Frames count from 0 at the start of a
// session. Texts must be UTF-8; others are refused.
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

// How important a session is when the server has to choose.
enum class Priority { hero = 1, near = 2, crowd = 3, batch = 4 };

// Exactly one of a text, a preset of the catalogue by its id, and a text encoder's vector. With a vector, the text may
// describe it for people.
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

// Who moves the playhead: the library, in real time, or the caller, by `Session::advance_to`.
enum class Clock { real_time, manual };

// How to open a session; the server chooses what is empty, absent or 0.
struct SessionOptions {
  std::string model_id;
  std::string rig_id;
  Prompt prompt;
  std::vector<std::pair<std::uint64_t, Prompt>> later_prompts;  // each with the frame from which it is in force
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
  // The motion just before frame 0, in place of a start pose: rows of the rig, a whole number of patches.
  std::vector<float> prior_rows;
  // Prompts stay in force even where targets ask for a pace that contradicts them; false: there the model is given the
  // gait for that pace, so that a character told to stand walks to its target.
  bool keep_prompts = false;
  FrameFormat frame_format = FrameFormat::f32;
  std::vector<std::string> outputs;  // of Model::outputs: further blocks of each row, at Rig::column(name)
  Clock clock = Clock::real_time;
  // How many frames behind the playhead stay readable, up to TimelineOptions::kMostKept, or kKeepAll; recovery needs 40
  // or more.
  std::uint32_t keep_frames = 40;
};

// What to change in an open session, from the next window on; what is absent stays as it is.
struct OptionsChange {
  std::optional<Priority> priority;
  std::optional<std::uint32_t> lookahead_frames;
  std::optional<std::uint32_t> denoise_steps;
  std::optional<std::uint32_t> history_frames;
  // The weights of text and of targets. Both are set: one that is absent in the pair returns to the model's default.
  std::optional<std::pair<std::optional<float>, std::optional<float>>> guidance;
};

// The number of an edit. Numbers rise in the order of the session's calls and stay valid across losses of the stream.
using EditId = std::uint64_t;

// Something that was accepted although the model was not trained for it.
struct Warning {
  // PROMPT_OUTSIDE_DOMAIN, UNTRAINED_CONSTRAINT, UNTRAINED_SPEED; or WARNINGS_LEFT_OUT, after the first 64, if the
  // server sent more
  std::string reason;
  std::string message;
  std::string field;
};

struct ServiceLevel {
  std::uint32_t tier = 1;  // 1 full, 2 fewer steps, 3 no guidance, 5 holds its pose
  std::uint32_t denoise_steps = 0;
};

// Where the server put a target that left frames or places to it.
struct Placement {
  std::uint32_t target = 0;  // its id
  std::uint64_t first_frame = 0;
  std::uint64_t last_frame = 0;
  std::uint64_t arrival_frame = 0;  // the frame between these two that the server aims for
  std::uint64_t anchor_frame = 0;   // the frame at which it takes effect
  float anchor_x_m = 0;             // the character just before that frame
  float anchor_z_m = 0;
  float anchor_heading_rad = 0;
};

// What the server chose for a session.
struct Opened {
  std::string session_id;  // unique across servers; the id in their traces
  std::string model_id;
  std::string rig_id;
  std::uint64_t seed = 0;
  std::uint32_t lookahead_frames = 0;
  std::uint32_t committed_horizon_frames = 0;
  std::uint32_t denoise_steps = 0;
  std::vector<Warning> warnings;
  std::vector<Placement> placements;
};

// Another server that has room: reached by its address, or by a routing key through the proxy already in use.
struct OtherServer {
  std::string address;
  std::string routing_key;
};

// The answer to an edit. `status` is OK or the server's refusal; docs/protocol.md lists the reasons. Of each
// text, 4,096 bytes are kept; the end of a longer one says how much was left out.
struct Outcome {
  Status status;
  std::optional<std::uint64_t> effective_frame;  // the first frame it affects; absent if it affects none
  std::string field;                             // the field at fault, if any
  std::string allowed;                           // the values allowed in it
  std::optional<double> retry_after_s;           // when to try the same again
  std::vector<OtherServer> other_servers;        // servers with room for a refused session, best first
  std::vector<Warning> warnings;
  std::vector<Placement> placements;
};

// What became of a target, reported once its last frame can no longer change.
struct Reached {
  std::uint32_t target = 0;               // its id
  bool met = false;                       // within its tolerances
  std::uint64_t frame = 0;                // the frame at which it was measured
  std::optional<float> position_error_m;  // absent: not part of the target
  std::optional<float> rotation_error_rad;
};

enum class EventKind {
  opened,           // the session has opened
  edit,             // an edit was answered: `edit`, `outcome`
  service_level,    // the service level has changed: `level`
  closed,           // the server ended or refused the session, or it could not be recovered: `outcome.status` says why
  connection_lost,  // sessions play what they hold while the client reconnects: `outcome.status`
  connected,        // the client has reconnected
  recovered,        // the session continues: `exact`; if it is false, motion is new from `frame` on
  draining,         // the server will end the stream: it refuses new sessions, the present ones continue until then
  reached,          // a target was met or missed: `reached`
  durability,       // whether another server could continue the session has changed: `is_durable`
};

struct Event {
  EventKind kind = EventKind::opened;
  std::uint32_t session = 0;  // Session::id; 0: the event concerns the connection
  EditId edit = 0;
  Outcome outcome;
  ServiceLevel level;
  std::uint64_t frame = 0;
  bool exact = false;
  bool is_durable = false;
  Reached reached;
};

}  // namespace motiongen
