// What a run measured: latencies, counts, and figures for each second, under the names that `motiongen bench` reads.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "load.pb.h"

namespace motiongen::load {

// Counts of latencies, in the buckets of an HdrHistogram from 1 us to 10 min with three digits.
class Histogram {
 public:
  void record(double seconds);
  void add(const Histogram& other);
  void write(Latencies& to) const;

 private:
  std::map<std::uint32_t, std::uint64_t> counts_;  // by the lowest value of each bucket, microseconds
};

enum class Latency { open, event, screen, answer, lateness, slack };
enum class Lag { send, loop, write };
enum class Figure { frames, due, missed, underruns, edits, opens, refused };

// Groups are numbered as in Load::groups.
class Recorder {
 public:
  explicit Recorder(const Load& load);

  void record(Latency what, std::size_t group, double seconds);
  void record(Lag what, double seconds);
  // The time from a ping to its pong.
  void record_round_trip(double seconds) { round_trips_.record(seconds); }
  void add_lags(Lag what, const Histogram& lags);
  // Add something that happened at a moment.
  void add(Figure what, std::size_t group, double at_s, double amount = 1);
  // Add something that went on at a rate.
  void add_span(Figure what, std::size_t group, double from_s, double to_s, double rate_hz);
  // Count something that is named in the report only once it has happened.
  void count(const std::string& name, std::uint64_t amount = 1) { counts_[name] += amount; }

  // The sum over all groups of seconds from_s up to to_s - 1.
  double total(Figure what, std::size_t from_s, std::size_t to_s) const;
  void write(const Load& load, Book& to) const;

 private:
  std::vector<double>& row(Figure what, std::size_t group);

  std::size_t num_seconds_;
  std::size_t num_groups_;
  std::vector<std::vector<double>> rows_;
  std::vector<Histogram> latencies_;
  std::vector<Histogram> lags_;
  Histogram round_trips_;
  std::map<std::string, std::uint64_t> counts_;
};

}  // namespace motiongen::load
