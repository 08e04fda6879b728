// How long to wait before the next call after one that was lost, or could not be made. Pure.
#pragma once

#include <algorithm>
#include <limits>

namespace motiongen {

class Backoff {
 public:
  static constexpr double kFirstS = 0.05;
  static constexpr double kGrowth = 1.6;
  static constexpr double kMostS = 2;
  // While what a character holds may last, it shall not lose another second to a server that is back.
  static constexpr double kSoonS = 3;
  static constexpr double kMostSoonS = 0.25;
  // The most that a server can be set to ask for.
  static constexpr double kMostAskedS = 3600;

  // Seconds that are waited where a server asks for some: one that says a century shall not be lost for good.
  static double bounded_s(double asked_s) { return std::clamp(asked_s, 0.0, kMostAskedS); }

  void begin_call() { num_pongs_ = 0; }
  void note_pong() { ++num_pongs_; }

  // Seconds to wait from a moment at which a call was lost or not made. They grow, until a call has proved itself: not
  // by its hello or its first pong, since something that is said on it may end every call at once.
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
  double since_s_ = std::numeric_limits<double>::infinity();  // of the first of these losses
};

}  // namespace motiongen
