// One character as its client sees it: its playback, which is computed, and its unanswered edits.
#pragma once

#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <vector>

#include "client/wire.hpp"
#include "load.pb.h"
#include "motiongen/v1/session.pb.h"
#include "recorder.hpp"

namespace motiongen::load {

// Shared by all characters of a run, and outlives them.
struct Run {
  const Load& load;
  Recorder& recorder;

  double frame_s() const { return 1.0 / load.frame_rate(); }
  bool measures(double at_s) const { return load.measure_from_s() <= at_s && at_s < load.measure_to_s(); }
};

// Uses no timer and keeps no frame data. When a frame is due follows from when playback began; whether it was there in
// time is determined when the next frames arrive. A character without a new frame holds its pose for whole frame times,
// as a game's loop would, and continues from there. All times are seconds from the start of the run.
class PlayedCharacter {
 public:
  PlayedCharacter(Run& run, std::uint32_t handle, const Character& plan);

  const Character& plan() const { return plan_; }
  const Group& group() const { return run_.load.groups(static_cast<int>(plan_.group())); }
  std::uint32_t handle() const { return handle_; }
  double close_s() const { return plan_.has_close_s() ? plan_.close_s() : std::numeric_limits<double>::infinity(); }
  bool is_live() const { return open_sent_ && !ended_; }  // events may be sent to it
  bool is_playing() const { return started_ && !ended_; }
  bool started() const { return started_; }
  bool ended() const { return ended_; }
  std::uint64_t committed_to() const { return committed_to_; }

  // ---- sending

  void note_open_sent() { open_sent_ = true; }
  // The number of the next event. With intended_s, it is an edit whose latency is measured.
  std::uint64_t take_seq(std::optional<double> intended_s = std::nullopt);
  // The frame being shown.
  std::uint64_t playhead(double now_s) const;
  // Append a report of it.
  void put_report(double now_s, std::string& to) const;

  // ---- receiving

  void take_plan(const v1::PlanNotice& notice, double now_s);
  void take_chunk(const ChunkHeader& chunk, double now_s);
  void take_outcome(const v1::EditOutcome& outcome, double now_s);

  // ---- measuring

  // Record the edits that have come on screen by now.
  void look(double now_s);
  // The session or the run is over. as_planned: if false, frames count as missed until the planned close.
  void end(double now_s, bool as_planned);
  // The run is over: record edits that still wait with the time waited so far; leaving them out would flatter the
  // server.
  void give_up_edits(double now_s);
  // The character closes as planned, before its last edits could be answered.
  void drop_edits();
  // The server refused to open the session.
  void refused() { ended_ = true; }

 private:
  struct Edit {
    double intended_s = 0;
    std::optional<std::uint64_t> first_frame;  // the first frame that it changes, once a plan has named the edit
    bool answered = false;
    bool changed = false;
  };
  struct Showing {  // an edit whose first changed frame has arrived but has not been shown
    double intended_s = 0;
    std::uint64_t frame = 0;
    double arrived_s = 0;
  };

  double due_s(std::uint64_t frame) const;
  void start(std::uint64_t first, double now_s);
  void meet_deadline(std::uint64_t frame, double now_s);
  std::uint32_t count_missed(double due_s, double now_s);
  void find_changed(std::uint64_t end, double now_s);
  void record(Latency what, double intended_s, double now_s);

  Run& run_;
  const std::uint32_t handle_;
  const Character& plan_;
  bool open_sent_ = false;
  bool started_ = false;
  bool ended_ = false;
  std::uint64_t next_seq_ = 1;
  std::uint64_t buffered_to_ = 0;
  std::uint64_t committed_to_ = 0;
  std::uint64_t shown_to_ = 0;  // frames below it have been shown, even if they were replaced later
  std::uint32_t missed_ = 0;
  std::uint32_t plan_number_ = 0;
  double epoch_s_ = 0;  // when frame 0 was due; moved on by every frame time of hold
  double due_from_s_;
  std::map<std::uint64_t, Edit> edits_;
  std::vector<Showing> showing_;
};

}  // namespace motiongen::load
