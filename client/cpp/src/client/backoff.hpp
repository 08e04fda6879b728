// How long to wait before the next call after one was lost or could not be made. Pure.
#pragma once

#include <algorithm>
#include <limits>

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

  void begin_call() { num_pongs_ = 0; }
  void note_pong() { ++num_pongs_; }

  // Seconds to wait after a call was lost or could not be made at now_s. They grow until a call has proved itself by
  // its second pong. Its hello or first pong is not enough: an event of ours may be what ends every call at once.
  double next_s(double now_s) {
    if (num_pongs_ > 1) {
      delay_s_ = 0;
      since_s_ = now_s;
    }
    num_pongs_ = 0;
    if (delay_s_ == 0) {
      delay_s_ = kFirstS;
      since_s_ = std::min(since_s_, now_s);
    } else {
      delay_s_ = std::min(delay_s_ * kGrowth, now_s - since_s_ < kSoonS ? kMostSoonS : kMostS);
    }
    return delay_s_;
  }

 private:
  int num_pongs_ = 0;
  double delay_s_ = 0;
  double since_s_ = std::numeric_limits<double>::infinity();  // when the first of these losses was
};

}  // namespace motiongen
