// How long to wait before the next attempt: a call after one that was lost or could not be made, or the opening of a
// session after the server has refused or ended it.
#pragma once

#include <algorithm>
#include <limits>
#include <random>

namespace motiongen {

class Backoff {
 public:
  static constexpr double kFirstS = 0.05;
  static constexpr double kGrowth = 1.6;
  static constexpr double kMostS = 2;
  // While sessions still have frames to play, waits stay short: they must not lose another second once the server is
  // back.
  static constexpr double kSoonS = 3;
  static constexpr double kMostSoonS = 0.25;
  // The longest wait that servers can be configured to ask for.
  static constexpr double kMostAskedS = 3600;

  // The wait for a server that asks for asked_s: bounded, so that a server which says a century is not lost for good.
  static double bounded_s(double asked_s) { return std::clamp(asked_s, 0.0, kMostAskedS); }

  // A call proves itself by its second pong. Its hello or first pong is not enough: an event of ours may be what ends
  // every call at once.
  void begin_call() { num_pongs_ = 0; }
  void note_pong() {
    if (++num_pongs_ > 1) is_proved_ = true;
  }
  // A session proves itself by its first frames. That it opens is not enough: it may be closed at once each time.
  void note_frames() { is_proved_ = true; }

  // Seconds to wait after an attempt has failed at now_s, before jitter. They grow until an attempt has proved itself.
  double next_s(double now_s) {
    if (is_proved_) {
      delay_s_ = 0;
      since_s_ = now_s;
    }
    is_proved_ = false;
    num_pongs_ = 0;
    if (delay_s_ == 0) {
      delay_s_ = kFirstS;
      since_s_ = std::min(since_s_, now_s);
    } else {
      delay_s_ = std::min(delay_s_ * kGrowth, now_s - since_s_ < kSoonS ? kMostSoonS : kMostS);
    }
    return delay_s_;
  }

  // A factor for the wait, so that not all who have lost the same server come back at once.
  template <class Random>
  static double jitter(Random& random) {
    return std::uniform_real_distribution<double>(0.8, 1.2)(random);
  }

 private:
  int num_pongs_ = 0;
  bool is_proved_ = false;
  double delay_s_ = 0;
  double since_s_ = std::numeric_limits<double>::infinity();  // when the first of these failures was
};

}  // namespace motiongen
