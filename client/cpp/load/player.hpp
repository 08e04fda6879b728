// Plays one process's part of a load: runs its streams, does what is due, and measures its own punctuality.
#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "character.hpp"
#include "load.pb.h"
#include "recorder.hpp"
#include "stream.hpp"

namespace motiongen::load {

class Player {
 public:
  // load: checked by find_fault; must outlive this.
  explicit Player(const Load& load);

  // Open the streams. Returns an error, or an empty string.
  std::string connect();
  // Play from start_at_s of CLOCK_MONOTONIC on. tell: called once a second, without locks held.
  void play(double start_at_s, const std::function<void(const Progress&)>& tell);
  // End the run and return what was measured.
  Book book();
  // End all streams at once. May take some seconds if a server does not end its calls.
  void stop();

 private:
  struct Intent {  // an event to send; rule: the group's, or one of the two below
    double at_s = 0;
    std::uint32_t character = 0;
    int rule = 0;
    std::uint32_t value = 0;
  };
  static constexpr int kOpen = -1;
  static constexpr int kClose = -2;
  static constexpr double kNoProbe = -1;

  void make_streams();
  void draw_up();
  void take_turns();
  Stream& stream_of(std::uint32_t character) { return *streams_[stream_index(character)]; }
  std::size_t stream_index(std::uint32_t character) const;
  double now_s() const;
  // Do what is due. Returns when something is due next.
  double act(double now_s);
  void act_on(const Intent& intent);
  void probe(double now_s);
  void report(const std::vector<std::uint32_t>& numbers, double now_s);
  void note_lag(Lag what, double due_s, double lag_s);
  void note_cpu(double now_s);
  Progress progress(double now_s) const;

  const Load& load_;
  Recorder recorder_;
  Run run_;
  Stage stage_;
  std::vector<std::shared_ptr<Stream>> streams_;
  std::deque<PlayedCharacter> characters_;
  std::vector<PlayedCharacter*> by_number_;  // nullptr: played by another process
  std::vector<Intent> intents_;
  std::size_t next_intent_ = 0;
  std::size_t num_turns_ = 1;                        // parts of a tick, among which streams are distributed
  std::vector<std::vector<std::uint32_t>> reports_;  // by turn: the characters whose playheads are reported
  std::vector<std::vector<Stream*>> pings_;
  std::atomic<double> start_at_s_{0};
  std::size_t next_turn_ = 0;
  double probe_due_s_ = kNoProbe;
  double cpu_from_s_ = -1;
  double cpu_to_s_ = -1;
};

// Why a load cannot be played; empty if it can.
std::string find_fault(const Load& load);

}  // namespace motiongen::load
