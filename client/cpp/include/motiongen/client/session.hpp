// One character. Made by Client::open; may be used from any thread, one call at a time or several.
#pragma once

#include <memory>

#include "motiongen/client/types.hpp"
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

  // A prompt from now on, in place of the present one and of those scheduled that have begun.
  [[nodiscard]] Result<EditId> set_prompt(const Prompt& prompt);
  // A prompt from a frame on, until `end_frame` (0: until another takes over). Its id is for `remove_prompt`.
  [[nodiscard]] Result<EditId> schedule_prompt(const Prompt& prompt, std::uint64_t start_frame,
                                               std::uint64_t end_frame = 0, std::uint32_t* prompt_id = nullptr);
  [[nodiscard]] Result<EditId> remove_prompt(std::uint32_t prompt_id);
  // Ids of the targets, in their order, are written to `ids` where it is given.
  [[nodiscard]] Result<EditId> add_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  // In place of all there are.
  [[nodiscard]] Result<EditId> set_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids = nullptr);
  [[nodiscard]] Result<EditId> remove_targets(Span<const std::uint32_t> ids);
  // Move over the ground, metres a second, for so many seconds or until the next call. 0, 0 is to stand.
  [[nodiscard]] Result<EditId> set_velocity(float x_mps, float z_mps, double seconds,
                                            std::optional<float> heading_rad = std::nullopt, bool keep_prompt = false);
  [[nodiscard]] Result<EditId> pause();
  [[nodiscard]] Result<EditId> resume();
  // End it. What it holds stays readable.
  [[nodiscard]] Status close();

  // ---- waiting, for those who may: DEADLINE_EXCEEDED when it takes longer, FAILED_PRECONDITION inside an event
  // callback

  [[nodiscard]] Result<Opened> wait_open(double timeout_s);
  // Of an edit of this session. Answers are kept for the last 1,024 edits.
  [[nodiscard]] Result<Outcome> wait_edit(EditId edit, double timeout_s);
  // What became of a target. Kept for the last 1,024 that were told.
  [[nodiscard]] Result<Reached> wait_reached(std::uint32_t target, double timeout_s);
  // Until the frame is held.
  [[nodiscard]] Status wait_frame(std::uint64_t frame, double timeout_s);

  // ---- frames. out: rig().row_width floats

  const Rig& rig() const;  // once it has opened; before that a rig without joints
  bool is_open() const;
  bool is_closed() const;
  // The pose to show now, between two frames; false before the first has come, and `out` is as it was.
  [[nodiscard]] bool sample(Span<float> out);
  // The frame to show now. Returns its number, nothing before the first has come.
  [[nodiscard]] std::optional<std::uint64_t> frame(Span<float> out);
  // A frame that is held. OUT_OF_RANGE tells which are.
  [[nodiscard]] Status copy_frame(std::uint64_t frame, Span<float> out) const;
  // Clock::manual: show this frame; the server goes on from there.
  [[nodiscard]] Status advance_to(std::uint64_t frame);

  std::uint64_t playhead() const;
  std::uint64_t buffered_to() const;
  std::uint64_t frame_in(double seconds) const;  // the one that is shown so many seconds from now
  SessionStats stats() const;

 private:
  friend class Client;
  Session(std::shared_ptr<ClientCore> core, std::shared_ptr<SessionState> state);
  [[nodiscard]] Result<EditId> edit_targets(Span<const Target> targets, std::vector<std::uint32_t>* ids, bool clear);
  [[nodiscard]] Result<EditId> play(bool paused);
  std::shared_ptr<ClientCore> core_;
  std::shared_ptr<SessionState> state_;
};

}  // namespace motiongen
