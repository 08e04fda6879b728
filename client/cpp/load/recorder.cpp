#include "recorder.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace motiongen::load {
namespace {

constexpr double kMostUs = 600'000'000;
constexpr std::uint32_t kExactTo = 2048;  // values below it have a bucket each: 2 * 10 ^ 3, up to a power of two
constexpr std::array<const char*, 6> kLatencies = {"open_to_first_frame", "event_to_first_frame", "event_to_screen",
                                                   "event_to_answer",     "chunk_lateness",       "chunk_slack"};
constexpr std::array<const char*, 3> kLags = {"send_lag", "loop_lag", "write_wait"};
constexpr std::array<const char*, 7> kFigures = {"frames", "due", "missed", "underruns", "edits", "opens", "refused"};
constexpr char kGenerator[] = "generator";
constexpr char kRoundTrip[] = "round_trip";
constexpr char kStreams[] = "streams";

}  // namespace

void Histogram::record(double seconds) {
  auto value = static_cast<std::uint32_t>(std::clamp(std::nearbyint(seconds * 1e6), 1.0, kMostUs));
  int shift = 0;
  while ((value >> shift) >= kExactTo) ++shift;
  ++counts_[value >> shift << shift];
}

void Histogram::add(const Histogram& other) {
  for (const auto& [value, count] : other.counts_) counts_[value] += count;
}

void Histogram::write(Latencies& to) const {
  for (const auto& [value, count] : counts_) {
    to.add_value_us(value);
    to.add_count(count);
  }
}

Recorder::Recorder(const Load& load)
    : num_seconds_(static_cast<std::size_t>(std::ceil(load.end_s()))),
      num_groups_(static_cast<std::size_t>(load.groups_size())),
      rows_(kFigures.size() * num_groups_, std::vector<double>(num_seconds_)),
      latencies_(kLatencies.size() * num_groups_),
      lags_(kLags.size()) {}

std::vector<double>& Recorder::row(Figure what, std::size_t group) {
  return rows_[static_cast<std::size_t>(what) * num_groups_ + group];
}

void Recorder::record(Latency what, std::size_t group, double seconds) {
  latencies_[static_cast<std::size_t>(what) * num_groups_ + group].record(seconds);
}

void Recorder::record(Lag what, double seconds) { lags_[static_cast<std::size_t>(what)].record(seconds); }

void Recorder::add_lags(Lag what, const Histogram& lags) { lags_[static_cast<std::size_t>(what)].add(lags); }

void Recorder::add(Figure what, std::size_t group, double at_s, double amount) {
  if (at_s > -1 && at_s < static_cast<double>(num_seconds_)) row(what, group)[static_cast<std::size_t>(at_s)] += amount;
}

void Recorder::add_span(Figure what, std::size_t group, double from_s, double to_s, double rate_hz) {
  std::vector<double>& amounts = row(what, group);
  for (auto second = static_cast<std::size_t>(std::max(from_s, 0.0)); second < num_seconds_; ++second) {
    const auto begin_s = static_cast<double>(second);
    if (begin_s >= to_s) break;
    amounts[second] += std::max(0.0, std::min(begin_s + 1, to_s) - std::max(begin_s, from_s)) * rate_hz;
  }
}

double Recorder::total(Figure what, std::size_t from_s, std::size_t to_s) const {
  double sum = 0;
  for (std::size_t group = 0; group < num_groups_; ++group) {
    const std::vector<double>& amounts = rows_[static_cast<std::size_t>(what) * num_groups_ + group];
    for (std::size_t second = from_s; second < std::min(to_s, num_seconds_); ++second) sum += amounts[second];
  }
  return sum;
}

void Recorder::write(const Load& load, Book& to) const {
  const auto put = [&to](const char* what, const std::string& group, const Histogram& histogram) {
    Latencies& latencies = *to.add_latencies();
    latencies.set_what(what);
    latencies.set_group(group);
    histogram.write(latencies);
    if (latencies.count_size() == 0) to.mutable_latencies()->RemoveLast();
  };
  for (std::size_t group = 0; group < num_groups_; ++group) {
    const std::string& name = load.groups(static_cast<int>(group)).name();
    for (std::size_t what = 0; what < kLatencies.size(); ++what) {
      put(kLatencies[what], name, latencies_[what * num_groups_ + group]);
    }
    for (std::size_t what = 0; what < kFigures.size(); ++what) {
      Seconds& seconds = *to.add_seconds();
      seconds.set_what(kFigures[what]);
      seconds.set_group(name);
      const std::vector<double>& amounts = rows_[what * num_groups_ + group];
      seconds.mutable_amount()->Add(amounts.begin(), amounts.end());
    }
  }
  for (std::size_t what = 0; what < kLags.size(); ++what) put(kLags[what], kGenerator, lags_[what]);
  put(kRoundTrip, kStreams, round_trips_);
  for (const auto& [name, count] : counts_) (*to.mutable_counts())[name] = count;
}

}  // namespace motiongen::load
