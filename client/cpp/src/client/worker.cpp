// What a client does by the clock: reports, what is said again, pings, reconnecting.
#include <chrono>

#include "client/convert.hpp"
#include "client/core.hpp"

namespace motiongen {
namespace {

constexpr double kTickS = 0.025;        // reports due in one tick share a message; at most 40 a second for each session
constexpr double kSilentPeriods = 2.5;  // ping periods without a message or a pong after which a server counts as lost

}  // namespace

void ClientCore::wake() {
  const std::lock_guard<std::mutex> lock(mutex_);
  woken_ = true;
  changed_.notify_all();
}

void ClientCore::work() {
  while (!closing_) {
    bool due = false;
    bool has_call = false;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait_for(lock, std::chrono::duration<double>(kTickS), [this] { return closing_ || woken_; });
      woken_ = false;
      due = is_lost_ && now_s() >= reconnect_at_s_;
      has_call = call_ != nullptr;
    }
    if (closing_) break;
    if (due) reconnect();
    if (connected_) tick(now_s());
    if (connected_ && wants_catalog_.exchange(false)) static_cast<void>(fetch_catalog(ask_timeout_s_));
    if (has_call && is_silent(now_s())) {
      drop_call(Status(Code::unavailable, "SERVER_SILENT", "no answer came from the server for too long"));
    }
    events_.dispatch();
  }
  end_calls();
}

// A server that sends but answers no ping is not reading. Resets the times, since the call is about to be ended.
bool ClientCore::is_silent(double now) {
  const double most_s = kSilentPeriods * options_.ping_period_s;
  const std::lock_guard<std::mutex> lock(mutex_);
  const bool is_deaf = unanswered_since_s_ > 0 && now - unanswered_since_s_ > most_s;
  if (!is_deaf && now - heard_at_s_ <= most_s) return false;
  heard_at_s_ = now;
  unanswered_since_s_ = 0;
  return true;
}

void ClientCore::tick(double now) {
  report(now);
  bool ping = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ping = now >= next_ping_s_;
    if (ping) next_ping_s_ = now + options_.ping_period_s;
  }
  if (ping) send_ping(now);
  flush();
}

void ClientCore::report(double now) {
  bool ended = false;
  for (const auto& state : sessions()) {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (now >= state->next_report_s) state->report(now, report_period_s(), outbox_);
    state->say_more(now, outbox_);
    const bool again = state->phase == Phase::waiting && now >= state->retry_at_s;
    if (again && connected_) state->send_open(outbox_, *catalog(), events_);
    ended = ended || state->phase == Phase::closed;
  }
  if (ended) forget_closed();
}

void ClientCore::send_ping(double now) {
  v1::StreamMotionRequest request;
  const auto now_ns = static_cast<std::int64_t>(now * 1e9);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    pinged_ns_ = now_ns;
    if (unanswered_since_s_ == 0) unanswered_since_s_ = now;
  }
  request.mutable_ping()->set_client_time_ns(now_ns);
  if (round_trip_s_ > 0) convert::set_seconds(round_trip_s_, request.mutable_ping()->mutable_round_trip());
  outbox_.put_ping(request);
}

}  // namespace motiongen
