#include "player.hpp"

#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <thread>
#include <tuple>

#include "edits.hpp"
#include "processor_time.hpp"

namespace motiongen::load {
namespace {

constexpr double kTickS = 0.025;
constexpr std::size_t kMostTurns = 25;  // parts of a tick: streams report at different times, as separate clients do
constexpr double kLeastSleepS = 0.001;  // events within a millisecond share a wake-up
constexpr double kProbeS = 0.01;        // how often the loop checks how late it wakes
constexpr std::size_t kPingTicks = 80;  // a stream is pinged every 80 ticks (2 s), streams at different times
constexpr double kProgressPeriodS = 1;
constexpr double kHelloTimeoutS = 15;
constexpr double kCloseGraceS = 5;   // the server's time to end all calls
constexpr double kCancelGraceS = 5;  // gRPC's time to end those that are left, once cancelled
constexpr std::uint32_t kHandlesFrom = 1;

double monotonic_s() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<double>(now.tv_sec) + static_cast<double>(now.tv_nsec) / 1e9;
}

}  // namespace

Player::Player(const Load& load) : load_(load), recorder_(load), run_{load, recorder_}, start_at_s_(monotonic_s()) {
  stage_.now_s = [this] { return now_s(); };
  make_streams();
  draw_up();
  take_turns();
}

double Player::now_s() const { return monotonic_s() - start_at_s_; }

std::size_t Player::stream_index(std::uint32_t character) const {
  return (character % load_.num_streams() - load_.process()) / load_.num_processes();
}

void Player::make_streams() {
  for (std::uint32_t index = load_.process(); index < load_.num_streams(); index += load_.num_processes()) {
    streams_.push_back(std::make_shared<Stream>(stage_, run_));
  }
  const auto count = static_cast<std::uint32_t>(load_.characters_size());
  by_number_.assign(count, nullptr);
  for (std::uint32_t number = 0; number < count; ++number) {
    if (number % load_.num_streams() % load_.num_processes() != load_.process()) continue;
    const std::uint32_t handle = kHandlesFrom + number / load_.num_streams();
    characters_.emplace_back(run_, handle, load_.characters(static_cast<int>(number)));
    by_number_[number] = &characters_.back();
    stream_of(number).adopt(characters_.back());
  }
}

void Player::draw_up() {
  for (std::uint32_t number = 0; number < by_number_.size(); ++number) {
    if (by_number_[number] == nullptr) continue;
    const Character& plan = by_number_[number]->plan();
    intents_.push_back({plan.open_s(), number, kOpen, 0});
    if (plan.has_close_s()) intents_.push_back({plan.close_s(), number, kClose, 0});
  }
  for (int edit = 0; edit < load_.edit_at_s_size(); ++edit) {
    const std::uint32_t number = load_.edit_character(edit);
    if (by_number_[number] == nullptr) continue;
    intents_.push_back(
        {load_.edit_at_s(edit), number, static_cast<int>(load_.edit_rule(edit)), load_.edit_value(edit)});
  }
  std::sort(intents_.begin(), intents_.end(), [](const Intent& a, const Intent& b) {
    return std::tie(a.at_s, a.character, a.rule, a.value) < std::tie(b.at_s, b.character, b.rule, b.value);
  });
}

void Player::take_turns() {
  num_turns_ = std::clamp(streams_.size(), std::size_t{1}, kMostTurns);
  const auto num_slices = static_cast<std::size_t>(std::max(1.0, std::nearbyint(1 / (load_.report_hz() * kTickS))));
  reports_.resize(num_slices * num_turns_);
  pings_.resize(kPingTicks * num_turns_);
  for (std::size_t index = 0; index < streams_.size(); ++index) {
    // Times seven spreads the pings over all turns, and does not tie a stream's pings to the turn in which it reports.
    pings_[index * 7 % pings_.size()].push_back(streams_[index].get());
  }
  for (std::uint32_t number = 0; number < by_number_.size(); ++number) {
    if (by_number_[number] == nullptr) continue;
    reports_[number % num_slices * num_turns_ + stream_index(number) % num_turns_].push_back(number);
  }
}

std::string Player::connect() {
  for (const auto& stream : streams_) stream->start();
  const double deadline_s = now_s() + kHelloTimeoutS;
  for (const auto& stream : streams_) {
    if (stream->wait_hello(std::max(deadline_s - now_s(), 0.0))) continue;
    const std::lock_guard<std::mutex> lock(stage_.mutex);
    return "no motiongen server answers at " + load_.address() + ": " +
           (stream->lost() ? stream->why_lost() : "no hello came in time");
  }
  return "";
}

void Player::play(double start_at_s, const std::function<void(const Progress&)>& tell) {
  start_at_s_ = start_at_s;
  double next_tell_s = 0;
  for (double now = now_s(); now < load_.end_s(); now = now_s()) {
    double next_s = 0;
    Progress told;
    const bool tells = now >= next_tell_s;
    {
      const std::lock_guard<std::mutex> lock(stage_.mutex);
      now = now_s();
      next_s = act(now);
      if (tells) told = progress(now);
    }
    for (const auto& stream : streams_) stream->flush();
    if (tells) {
      next_tell_s = now + kProgressPeriodS;
      tell(told);
    }
    const double pause_s = std::max(std::min(next_s, load_.end_s()) - now_s(), kLeastSleepS);
    std::this_thread::sleep_for(std::chrono::duration<double>(pause_s));
  }
  const std::lock_guard<std::mutex> lock(stage_.mutex);
  probe(now_s());  // the process may have been stalled until the end
}

double Player::act(double now) {
  probe(now);
  for (; next_intent_ < intents_.size() && intents_[next_intent_].at_s <= now; ++next_intent_) {
    act_on(intents_[next_intent_]);
  }
  const double turn_s = kTickS / static_cast<double>(num_turns_);
  if (now >= static_cast<double>(next_turn_) * turn_s) {
    const std::size_t last = std::max(next_turn_, static_cast<std::size_t>(now / turn_s));
    // A missed tick is skipped.
    for (std::size_t turn = std::max(next_turn_ + num_turns_, last + 1) - num_turns_; turn <= last; ++turn) {
      report(reports_[turn % reports_.size()], now);
      for (Stream* stream : pings_[turn % pings_.size()]) stream->put_ping();
    }
    next_turn_ = last + 1;
    note_cpu(now);
  }
  double next_s = std::min(static_cast<double>(next_turn_) * turn_s, probe_due_s_);
  if (next_intent_ < intents_.size()) next_s = std::min(next_s, intents_[next_intent_].at_s);
  return next_s;
}

// Samples how late the loop wakes, at a fixed interval whatever else wakes it, so that the number of streams and turns
// does not matter. After a stall it records every probe that was due meanwhile; otherwise a stall of any length would
// be a single sample among a hundred a second.
void Player::probe(double now) {
  if (probe_due_s_ != kNoProbe && now < probe_due_s_) {
    probe_due_s_ = std::max(probe_due_s_, now + kLeastSleepS);  // the loop sleeps at least so long
    return;
  }
  if (probe_due_s_ != kNoProbe) {
    for (double due_s = probe_due_s_; due_s <= now; due_s += kProbeS) note_lag(Lag::loop, due_s, now - due_s);
  }
  probe_due_s_ = now + kProbeS;
}

void Player::act_on(const Intent& intent) {
  const double now = now_s();  // earlier work in this turn may have delayed it
  PlayedCharacter& character = *by_number_[intent.character];
  Stream& stream = stream_of(intent.character);
  const std::uint32_t group = character.plan().group();
  if (intent.rule == kOpen) {
    character.note_open_sent();
    if (stream.lost()) {  // its player sees a lost session
      character.end(now, false);
      return recorder_.count("opens_not_sent");
    }
    stream.put(open_event(character, load_));
    recorder_.add(Figure::opens, group, intent.at_s);
  } else if (!character.is_live()) {
    return recorder_.count("events_of_characters_that_are_not_there");
  } else if (intent.rule == kClose) {
    stream.put(close_event(character));
    character.drop_edits();
    character.end(now, true);
  } else {
    const Rule& rule = character.group().rules(intent.rule);
    stream.put(edit_event(character, load_, rule, intent.value, intent.at_s, now));
    recorder_.add(Figure::edits, group, intent.at_s);
  }
  note_lag(Lag::send, intent.at_s, now - intent.at_s);
}

void Player::report(const std::vector<std::uint32_t>& numbers, double now) {
  for (const std::uint32_t number : numbers) {
    PlayedCharacter& character = *by_number_[number];
    if (!character.is_playing()) continue;
    character.look(now);
    stream_of(number).put_report(character, now);
  }
}

// Selected by when it was due, as latencies are by when edits were intended: a stall may last beyond the measured time.
void Player::note_lag(Lag what, double due_s, double lag_s) {
  if (run_.measures(due_s)) recorder_.record(what, std::max(lag_s, 0.0));
}

void Player::note_cpu(double now) {
  if (cpu_from_s_ < 0 && now >= load_.measure_from_s()) cpu_from_s_ = processor_time_s();
  if (cpu_to_s_ < 0 && now >= load_.measure_to_s()) cpu_to_s_ = processor_time_s();
}

Progress Player::progress(double now) const {
  const auto second = static_cast<std::size_t>(now);
  const auto playing = std::count_if(characters_.begin(), characters_.end(),
                                     [](const PlayedCharacter& each) { return each.is_playing(); });
  const auto total = [this](Figure what, std::size_t from_s, std::size_t to_s) {
    return static_cast<std::uint64_t>(std::llround(recorder_.total(what, from_s, to_s)));
  };
  Progress progress;
  progress.set_at_s(now);
  progress.set_playing(static_cast<std::uint32_t>(playing));
  if (second > 0) progress.set_missed(total(Figure::missed, second - 1, second));
  progress.set_edits(total(Figure::edits, 0, second + 1));
  progress.set_refused(total(Figure::refused, 0, second + 1));
  return progress;
}

Book Player::book() {
  const std::lock_guard<std::mutex> lock(stage_.mutex);
  const double end_s = now_s();
  for (PlayedCharacter& character : characters_) {
    character.look(end_s);
    character.give_up_edits(end_s);
    character.end(end_s, true);
  }
  for (const auto& stream : streams_) stream->write_waits(recorder_);
  Book book;
  recorder_.write(load_, book);
  const double used_s = processor_time_s();
  book.set_cpu_s((cpu_to_s_ < 0 ? used_s : cpu_to_s_) - (cpu_from_s_ < 0 ? used_s : cpu_from_s_));
  book.set_streams(static_cast<std::uint32_t>(streams_.size()));
  return book;
}

void Player::stop() {
  for (const auto& stream : streams_) stream->begin_end();
  const auto wait_all = [this](double grace_s, bool cancels) {
    const double deadline_s = monotonic_s() + grace_s;
    for (const auto& stream : streams_) {
      if (!stream->wait_ended(std::max(deadline_s - monotonic_s(), 0.0)) && cancels) stream->cancel();
    }
  };
  wait_all(kCloseGraceS, true);
  wait_all(kCancelGraceS, false);
}

}  // namespace motiongen::load
