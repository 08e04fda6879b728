// A session: one character, opened by Client::open. May be used from any number of threads at the same time.
#pragma once

#include <memory>

#include "motiongen/client/types.hpp"
#include "motiongen/core/ground.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {

class ClientCore;
class SessionState;

// Counters of one session so far.
struct SessionStats {
  std::uint32_t plans = 0;
  std::uint64_t frames = 0;      // received, including those replaced later
  std::uint32_t underruns = 0;   // frame times at which there was no new frame and the last pose was held
  std::uint32_t late_plans = 0;  // plans that came too late to replace all their frames
  std::uint32_t recoveries = 0;  // losses of the stream that the session survived
};

// Edits are numbered and go to the server at once and in order. Their answers arrive as events of the client and
// through `wait_edit`. After the session has ended, edits fail with FAILED_PRECONDITION. The destructor closes the
// session.
class MOTIONGEN_API Session {
 public:
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;
  ~Session();

  std::uint32_t id() const;  // as in Event::session

  // ---- edits

  // Set the present prompt. It replaces the one before and all scheduled prompts without an end that have begun.
  [[nodiscard]] Result<EditId> set_prompt(const Prompt& prompt);
  // A prompt from `start_frame` until `end_frame` (0: until another takes over). replace_prompt and remove_prompt take
  // its id.
  [[nodiscard]] Result<EditId> schedule_prompt(const Prompt& prompt, std::uint64_t start_frame,
                                               std::uint64_t end_frame = 0, std::uint32_t* prompt_id = nullptr);
  // Replace a scheduled prompt, also at other frames, or the present prompt, whose id is 1.
  [[nodiscard]] Result<EditId> replace_prompt(std::uint32_t prompt_id, const Prompt& prompt, std::uint64_t start_frame,
                                              std::uint64_t end_frame = 0);
  // Remove a prompt. Where no prompt is in force any more, motion is generated without text.
  [[nodiscard]] Result<EditId> remove_prompt(std::uint32_t prompt_id);
  // The ids of the targets, in their order, are written to `ids` if it is not null.
  [[nodiscard]] Result<EditId> add_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  // The same, replacing all targets of the session.
  [[nodiscard]] Result<EditId> set_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  // Replace one target; the id stays the same.
  [[nodiscard]] Result<EditId> replace_target(std::uint32_t id, const Target& target);
  // Walk to a ground position, however far away, and be there as soon as a person can: `Outcome::placements` says when.
  // relative_to_character: x_m is to its left, z_m ahead of it, heading_rad relative to where it faces.
  [[nodiscard]] Result<EditId> go_to(float x_m, float z_m, std::optional<float> heading_rad = std::nullopt,
                                     bool relative_to_character = false, std::uint32_t* id = nullptr);
  // Walk from here along straight lines through corners_m (x, z each) and stop at the last. Defaults: speed_mps 1.2;
  // smoothing_m, how far corners may be cut, 0.3.
  [[nodiscard]] Result<EditId> follow_path(Span<const float> corners_m, std::optional<float> speed_mps = std::nullopt,
                                           std::optional<float> smoothing_m = std::nullopt,
                                           std::uint32_t* id = nullptr);
  [[nodiscard]] Result<EditId> remove_targets(Span<const std::uint32_t> ids);
  // Move over the ground at a velocity, for so many seconds or until the next call. 0, 0: stand. keep_prompt: the
  // session's prompts stay in force meanwhile, else a gait's is. Of calls that follow one another while the stream is
  // lost, only the last is sent; its answer is that of the others too.
  [[nodiscard]] Result<EditId> set_velocity(float x_mps, float z_mps, double seconds,
                                            std::optional<float> heading_rad = std::nullopt, bool keep_prompt = false);
  // Stand at another place from the first frame that can still change: a cut, without blending.
  [[nodiscard]] Result<EditId> teleport(float x_m, float z_m, float heading_rad = 0);
  // Continue from the given frames, a whole number of patches, as if they had come just before. rows: rig().row_width
  // floats each.
  [[nodiscard]] Result<EditId> cut_to(Span<const float> rows);
  // Continue from one of the session's own frames, as if the frames before it had just been shown: a second try from
  // that moment. The server keeps some seconds behind the playhead; a refusal with FRAME_NOT_HELD says which frames it
  // has.
  [[nodiscard]] Result<EditId> seek(std::uint64_t frame);
  // Change options of the open session, from the next window on. The server may refuse a change for which it has no
  // room.
  [[nodiscard]] Result<EditId> set_options(const OptionsChange& change);
  [[nodiscard]] Result<EditId> pause();
  [[nodiscard]] Result<EditId> resume();
  // End the session. The frames that it holds stay readable.
  [[nodiscard]] Status close();

  // ---- waiting: DEADLINE_EXCEEDED when it takes longer than timeout_s, FAILED_PRECONDITION inside an event callback.
  // timeout_s: infinity waits for ever; INVALID_ARGUMENT for NaN

  [[nodiscard]] Result<Opened> wait_open(double timeout_s);
  // The answer to an edit of this session. The last 1,024 answers are kept, or as many as fit into 16 MiB;
  // INVALID_ARGUMENT for an edit of earlier ones, or of none.
  [[nodiscard]] Result<Outcome> wait_edit(EditId edit, double timeout_s);
  // Where the server put a target that left frames or places to it; nothing until the answer has arrived. The last
  // 1,024 are kept.
  std::optional<Placement> placement(std::uint32_t target) const;
  // What became of a target; the last 1,024 results are kept. If there will be no result, the status says why: the
  // target was refused, or its frames passed while the connection was lost (FRAME_COMMITTED). For a removed target the
  // wait only ends with the session. INVALID_ARGUMENT for an id that was not given out.
  [[nodiscard]] Result<Reached> wait_reached(std::uint32_t target, double timeout_s);
  // Wait until the frame has arrived and, with Clock::manual, may be shown (`advance_to`). By then it may already have
  // been dropped, as frames more than `keep_frames` behind the playhead are: `copy_frame` tells.
  [[nodiscard]] Status wait_frame(std::uint64_t frame, double timeout_s);

  // ---- frames. out: rig().row_width floats or more; if it is shorter, nothing is written and there is no pose

  const Rig& rig() const;  // before the session has opened, a rig without joints
  bool is_open() const;
  bool is_closed() const;
  // Whether the server saves the session, so that another server can continue it.
  bool is_durable() const;
  // The pose to show now, interpolated between two frames (with Clock::manual, that of the frame moved to). Returns
  // false and leaves `out` unchanged until the first frame has arrived.
  [[nodiscard]] bool sample(Span<float> out);
  // The same, adapted to a ground. Each session needs a GroundFollower of its own, whose heights function is called
  // inside this call and must not use the session. INVALID_ARGUMENT if the ground is for another rig, `out` is too
  // short, or a height is not finite.
  [[nodiscard]] Result<bool> sample_on_ground(GroundFollower& ground, Span<float> out);
  // The frame to show now. Returns its number, or nothing until the first frame has arrived.
  [[nodiscard]] std::optional<std::uint64_t> frame(Span<float> out);
  // A frame that is held; otherwise OUT_OF_RANGE, whose message says which frames are. A frame ahead of the playhead
  // may still be replaced.
  [[nodiscard]] Status copy_frame(std::uint64_t frame, Span<float> out) const;
  // Clock::manual: move the playhead to this frame. OUT_OF_RANGE with the reason FRAME_NOT_HELD if it is behind the
  // playhead or has not arrived yet, or EDIT_UNANSWERED if an edit that is not answered yet may replace it: try again
  // later, or call `wait_frame` first, which waits for both. So frames may be shown faster than in real time, and edits
  // still only affect frames after those shown.
  [[nodiscard]] Status advance_to(std::uint64_t frame);
  // Play slower or faster than real time: 0.5 is half as fast. The server may not keep up with scales much above 1.
  [[nodiscard]] Status set_time_scale(double scale);

  std::uint64_t playhead() const;
  std::uint64_t buffered_to() const;
  std::uint64_t frame_in(double seconds) const;  // the frame that is shown so many seconds from now
  SessionStats stats() const;

 private:
  friend class Client;
  Session(std::shared_ptr<ClientCore> core, std::shared_ptr<SessionState> state);
  [[nodiscard]] Result<EditId> add_target(const Target& target, std::uint32_t* id);
  [[nodiscard]] Result<EditId> edit_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids, bool clear);
  [[nodiscard]] Result<EditId> play(bool paused);
  double frame_rate_hz() const;
  [[nodiscard]] Result<bool> show(GroundFollower* ground, Span<float> out);
  std::shared_ptr<ClientCore> core_;
  std::shared_ptr<SessionState> state_;
};

}  // namespace motiongen
