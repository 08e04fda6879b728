// The pace at which a session says again what has no answer: no faster than servers let a session speak, since they
// refuse what is more.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>

namespace motiongen {

class Repeating {
 public:
  static constexpr double kPeriodS = 0.25;  // between parts; longer if the server's rate limit is very low
  static constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();

  // Whether events remain to be said again: new ones must wait behind them.
  bool is_under_way() const { return next_seq_.has_value(); }
  // The number of the next of them.
  std::uint64_t next_seq() const { return next_seq_.value_or(0); }

  // Begin with the first of them. per_second: how many events the server takes in a second of one session; 0: any
  // number. Returns how many to say at once: half a second's. A third of the rate follows, since reports of the
  // playhead count too.
  std::size_t begin(double per_second) {
    const bool is_limited = per_second > 0;
    const double rate_hz = is_limited ? std::min(per_second, kMostHz) : kMostHz;
    period_s_ = std::max(kPeriodS, 3 / rate_hz);
    part_ = std::max<std::size_t>(static_cast<std::size_t>(rate_hz / 3 * period_s_), 1);
    due_s_.reset();
    next_seq_ = 0;
    return is_limited ? std::max<std::size_t>(static_cast<std::size_t>(rate_hz / 2), 1) : kAll;
  }

  // How many to say now; 0 while none are due. A period begins when this is first asked.
  std::size_t part_due(double now_s) {
    if (due_s_ && now_s >= *due_s_) {
      due_s_ = now_s + period_s_;
      return part_;
    }
    if (!due_s_) due_s_ = now_s + period_s_;
    return 0;
  }

  void go_on_from(std::uint64_t seq) { next_seq_ = seq; }
  void stop() { next_seq_.reset(); }

 private:
  static constexpr double kMostHz = 1e6;  // a server may name any number

  std::optional<std::uint64_t> next_seq_;
  std::optional<double> due_s_;
  double period_s_ = kPeriodS;
  std::size_t part_ = 1;
};

}  // namespace motiongen
