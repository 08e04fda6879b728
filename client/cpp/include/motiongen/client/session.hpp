// One character. Made by Client::open; may be used from any thread, one call at a time or several.
#pragma once

#include <memory>

#include "motiongen/client/types.hpp"
#include "motiongen/core/ground.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {

class ClientCore;
class SessionState;

// Counts of one session so far.
struct SessionStats {
  std::uint32_t plans = 0;
  std::uint64_t frames = 0;      // received, replaced ones too
  std::uint32_t underruns = 0;   // frame times for which the last pose had to be held
  std::uint32_t late_plans = 0;  // that reached behind the playhead
  std::uint32_t recoveries = 0;  // losses of the stream that it outlived
};

// Changes go to the server at once and in order, and are numbered; their answers come as events of the client, and to
// whoever waits. After the session's end calls say FAILED_PRECONDITION. Destroying it closes it.
class MOTIONGEN_API Session {
 public:
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;
  ~Session();

  std::uint32_t id() const;  // as in Event::session

  // ---- what it is told

  // A prompt from now on, in place of the present one and of those scheduled without an end that have begun.
  [[nodiscard]] Result<EditId> set_prompt(const Prompt& prompt);
  // A prompt from a frame on, until `end_frame` (0: until another takes over). Its id is for `remove_prompt`.
  [[nodiscard]] Result<EditId> schedule_prompt(const Prompt& prompt, std::uint64_t start_frame,
                                               std::uint64_t end_frame = 0, std::uint32_t* prompt_id = nullptr);
  // Put another in the place of a scheduled one, at other frames if need be, or in that of the present one, whose
  // id is 1.
  [[nodiscard]] Result<EditId> replace_prompt(std::uint32_t prompt_id, const Prompt& prompt, std::uint64_t start_frame,
                                              std::uint64_t end_frame = 0);
  // Drop one of them. Where no prompt holds any more the motion has no text.
  [[nodiscard]] Result<EditId> remove_prompt(std::uint32_t prompt_id);
  // Ids of the targets, in their order, are written to `ids` where it is given.
  [[nodiscard]] Result<EditId> add_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  // In place of all there are.
  [[nodiscard]] Result<EditId> set_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  // Put another in the place of one; it keeps the id.
  [[nodiscard]] Result<EditId> replace_target(std::uint32_t id, const Target& target);
  // Walk to a ground position, however far, and be there as soon as a person can: `Outcome::placements` says when.
  // relative_to_character: x_m to its left, z_m ahead of it, heading_rad from where it faces.
  [[nodiscard]] Result<EditId> go_to(float x_m, float z_m, std::optional<float> heading_rad = std::nullopt,
                                     bool relative_to_character = false, std::uint32_t* id = nullptr);
  // Walk from here along lines through corners_m (x, z each) and stand at the last. speed_mps: 1.2 unless given;
  // smoothing_m: how far corners are cut, 0.3 unless given.
  [[nodiscard]] Result<EditId> follow_path(Span<const float> corners_m, std::optional<float> speed_mps = std::nullopt,
                                           std::optional<float> smoothing_m = std::nullopt,
                                           std::uint32_t* id = nullptr);
  [[nodiscard]] Result<EditId> remove_targets(Span<const std::uint32_t> ids);
  // Move over the ground, metres a second, for so many seconds or until the next call. 0, 0 is to stand.
  [[nodiscard]] Result<EditId> set_velocity(float x_mps, float z_mps, double seconds,
                                            std::optional<float> heading_rad = std::nullopt, bool keep_prompt = false);
  // Stand elsewhere from the first frame that can still change: a cut, at which nothing is blended.
  [[nodiscard]] Result<EditId> teleport(float x_m, float z_m, float heading_rad = 0);
  // Go on from other frames, whole patches of them, as if they had come just before. rows: of rig().row_width floats.
  [[nodiscard]] Result<EditId> cut_to(Span<const float> rows);
  // Go on from a frame of its own, as if the frames before that one had just been: another way out of a moment. The
  // server keeps some seconds behind the playhead; the answer FRAME_NOT_HELD says which frames it has.
  [[nodiscard]] Result<EditId> seek(std::uint64_t frame);
  // Change what it was opened with, from the next window on. The server may refuse more than there is room for.
  [[nodiscard]] Result<EditId> set_options(const OptionsChange& change);
  [[nodiscard]] Result<EditId> pause();
  [[nodiscard]] Result<EditId> resume();
  // End it. What it holds stays readable.
  [[nodiscard]] Status close();

  // ---- waiting, for those who may: DEADLINE_EXCEEDED when it takes longer, FAILED_PRECONDITION inside an event
  // callback. timeout_s: infinity waits for ever; INVALID_ARGUMENT for no number

  [[nodiscard]] Result<Opened> wait_open(double timeout_s);
  // Of an edit of this session. Answers are kept for the last 1,024 edits.
  [[nodiscard]] Result<Outcome> wait_edit(EditId edit, double timeout_s);
  // Where a target was put that left that to the server; nothing before the answer. Kept for the last 1,024.
  std::optional<Placement> placement(std::uint32_t target) const;
  // What became of a target. Kept for the last 1,024 that were told. Of one that is told of by nobody, why: its
  // refusal, or FRAME_COMMITTED where its frames passed while the line was lost. One that is removed is waited for
  // until the session ends.
  [[nodiscard]] Result<Reached> wait_reached(std::uint32_t target, double timeout_s);
  // Until the frame has come and, with Clock::manual, may be shown (`advance_to`). It may be gone again by then, as
  // those are that lie `keep_frames` behind the playhead: `copy_frame` tells.
  [[nodiscard]] Status wait_frame(std::uint64_t frame, double timeout_s);

  // ---- frames. out: rig().row_width floats or more; into fewer nothing is written, and there is no pose

  const Rig& rig() const;  // once it has opened; before that a rig without joints
  bool is_open() const;
  bool is_closed() const;
  // Whether its server saves it, so that another can go on with it.
  bool is_durable() const;
  // The pose to show now, between two frames (with Clock::manual that of the frame it was moved to); false before the
  // first has come, and `out` is as it was.
  [[nodiscard]] bool sample(Span<float> out);
  // The same on a ground that no other session is followed on. Its heights are asked for inside this call and must not
  // use the session. INVALID_ARGUMENT where the ground is of another rig, `out` is too short, or a height is not
  // finite.
  [[nodiscard]] Result<bool> sample_on_ground(GroundFollower& ground, Span<float> out);
  // The frame to show now. Returns its number, nothing before the first has come.
  [[nodiscard]] std::optional<std::uint64_t> frame(Span<float> out);
  // A frame that is held. OUT_OF_RANGE tells which are. One ahead of the playhead may still be replaced.
  [[nodiscard]] Status copy_frame(std::uint64_t frame, Span<float> out) const;
  // Clock::manual: show this frame; the server goes on from there. OUT_OF_RANGE where it is behind the playhead or has
  // not come yet, FRAME_NOT_HELD, and where an edit that has no answer yet may replace it, EDIT_UNANSWERED: try again
  // later, or use `wait_frame` first, which waits for both. So frames may be shown sooner than in real time, and what
  // the character is told begins behind those that were.
  [[nodiscard]] Status advance_to(std::uint64_t frame);
  // Play slower or faster than real time: 0.5 is half as fast. The server may not keep up with much above 1.
  [[nodiscard]] Status set_time_scale(double scale);

  std::uint64_t playhead() const;
  std::uint64_t buffered_to() const;
  std::uint64_t frame_in(double seconds) const;  // the one that is shown so many seconds from now
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
