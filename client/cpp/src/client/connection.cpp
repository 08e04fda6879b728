// A client's connection: making it, recovering from its loss, and ending it.
#include <algorithm>
#include <iterator>
#include <limits>

#include "client/convert.hpp"
#include "client/core.hpp"
#include "client/status_details.hpp"
#include "client/texts.hpp"
#include "client/timeouts.hpp"
#include "motiongen/v1/service.grpc.pb.h"

namespace motiongen {
namespace {

constexpr double kCloseGraceS = 2;                  // the server's time to end the call
constexpr double kCancelGraceS = 5;                 // gRPC's time to end it once cancelled
constexpr char kStarting[] = "STARTING";            // the reason given by a server that has no engine yet
constexpr char kExpired[] = "CREDENTIALS_EXPIRED";  // the reason given if the caller needs another token
constexpr char kAgent[] = "motiongen-cpp/0.1.0";
constexpr std::size_t kMostAgentBytes = 100;  // of the application's part

// Whether retrying can help: the codes with which a stream ends if a server is lost or a proxy fails.
bool is_loss(const Status& status) {
  const Code code = status.code();
  return code != Code::invalid_argument && code != Code::unauthenticated && code != Code::permission_denied &&
         code != Code::unimplemented && status.reason() != "PROTOCOL_VIOLATION";
}

// Whether no call was made because there was no token; then no server is at fault.
bool lacks_token(const Status& status) { return status.reason() == kTokenSource; }

// What to tell of a server that could not be connected to. gRPC tells nobody why a handshake failed, so what to check
// is named.
std::string none_answers(const ClientOptions& options, const Status& why) {
  std::string text = "no motiongen server answers at " + options.address + " (" + name_of(why.code()) + ": " +
                     why.message() + "). Is it running and ready (/readyz), and are both with TLS, or both without it?";
  if (options.tls && why.code() == Code::deadline_exceeded) {
    text +=
        " Its certificate must name this address and come from an authority that is trusted here, and it may "
        "require one of the client.";
  }
  return text;
}

}  // namespace

Status ClientCore::fetch_catalog(double timeout_s) {
  ShortCall call(*this, timeout_s);
  if (!call.made) return call.made;
  call.context.set_wait_for_ready(servers_.size() == 1);  // of several servers, skip one that is down
  v1::GetCatalogRequest request;
  v1::GetCatalogResponse response;
  const grpc::Status status =
      v1::MotionService::NewStub(server().channel)->GetCatalog(&call.context, request, &response);
  if (!status.ok()) return status_of(status);
  auto made = convert::catalog(response);
  if (!made) return made.status();
  const std::lock_guard<std::mutex> lock(mutex_);
  catalog_ = made.value();
  outbox_.set_limit(catalog_->limits.max_request_bytes);
  return {};
}

Status ClientCore::try_connect(double deadline_s) {
  Status asked = fetch_catalog(std::max(deadline_s - now_s(), 0.01));
  if (!asked) {
    if (!lacks_token(asked)) route_.pass_over(asked.reason() == kStarting);
    return asked;
  }
  Status begun = begin_call();
  if (!begun) return begun;
  const auto is_over = [this] { return call_ == nullptr; };
  std::unique_lock<std::mutex> lock(mutex_);
  const auto left = std::chrono::duration<double>(std::max(deadline_s - now_s(), 0.1));
  const bool told = changed_.wait_for(lock, left, [&] { return connected_ || is_over(); });
  if (connected_) return {};
  if (told) return failure_;
  lock.unlock();
  Status late(Code::deadline_exceeded, "", "no hello came in time");
  drop_call(late);  // so that the next call, perhaps to another server, is the only one
  lock.lock();
  changed_.wait_for(lock, std::chrono::duration<double>(kCancelGraceS), is_over);
  return late;
}

Status ClientCore::connect() {
  Status checked = check_options();
  if (!checked) return checked;
  make_channels();
  const double deadline_s = now_s() + bounded_s(options_.connect_timeout_s);
  const bool has_others = servers_.size() > 1;
  Status why;
  for (double wait_s = Backoff::kFirstS;; wait_s = std::min(Backoff::kGrowth * wait_s, Backoff::kMostS)) {
    // while others might answer, do not wait long for a server that accepts the call but stays silent
    why = try_connect(has_others ? std::min(deadline_s, now_s() + ask_timeout_s_) : deadline_s);
    // the server is loading its model, was lost meanwhile, or is overloaded at the moment
    const bool may_pass = why.code() == Code::unavailable || why.code() == Code::resource_exhausted ||
                          (has_others && why.code() == Code::deadline_exceeded);
    const double left_s = deadline_s - now_s();
    if (!may_pass || lacks_token(why) || left_s <= 0) break;
    std::this_thread::sleep_for(std::chrono::duration<double>(std::min(wait_s, left_s)));
  }
  if (!why) {
    shut_down();
    if (lacks_token(why)) return why;
    const Code code = why.code() == Code::deadline_exceeded ? Code::unavailable : why.code();
    return {code, why.reason(), none_answers(options_, why)};
  }
  worker_ = std::thread([core = shared_from_this()] { core->work(); });
  return {};
}

Status ClientCore::begin_call() {
  const auto metadata = metadata_.make(route_.key());
  if (!metadata) return metadata.status();
  v1::StreamMotionRequest hello;
  hello.mutable_hello()->set_client_agent(
      options_.agent.empty() ? kAgent : kAgent + first_bytes(" " + options_.agent, kMostAgentBytes));
  convert::set_seconds(options_.flush_interval_s, hello.mutable_hello()->mutable_flush_interval());
  outbox_.clear();
  outbox_.put_alone(hello);
  heard_at_s_ = now_s();
  std::vector<std::shared_ptr<Call>> ended;  // released after the lock
  const std::lock_guard<std::mutex> lock(mutex_);
  if (closing_) return {};
  // a call whose end is still being reported, as inside a slow callback, is in use there until then
  const auto first =
      std::partition(ended_calls_.begin(), ended_calls_.end(), [](const auto& each) { return !each->wait_ended(0); });
  std::move(first, ended_calls_.end(), std::back_inserter(ended));
  ended_calls_.erase(first, ended_calls_.end());
  is_lost_ = false;
  goodbye_.reset();
  drop_reason_ = Status();  // left by a call that had ended already
  backoff_.begin_call();
  next_ping_s_ = now_s();
  unanswered_since_s_ = 0;
  call_ = Call::start(*server().stub, metadata.value(), outbox_, shared_from_this());
  return {};
}

void ClientCore::on_call_ended(const grpc::Status& status, std::shared_ptr<Call> call) {
  Status why =
      status.ok() ? Status(Code::unavailable, "STREAM_ENDED", "the server ended the stream") : status_of(status);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ended_calls_.push_back(std::move(call));
    if (!drop_reason_) why = drop_reason_;
    drop_reason_ = Status();
  }
  // after an expired token, the next call is final: if it has no better token, the server refuses it for good
  const bool may_pass = is_loss(why) || (connected_ && why.reason() == kExpired);
  lose(why, options_.reconnect && may_pass && !closing_);
  events_.dispatch();
}

// Choose the server to call next after a loss or a failed attempt. Returns the least number of seconds to wait, which a
// server asked for. With mutex_ held.
double ClientCore::choose_server(bool was_connected, const Status& why) {
  if (!was_connected) {
    if (!lacks_token(why)) route_.pass_over(why.reason() == kStarting);
    return 0;
  }
  const v1::Goodbye goodbye = goodbye_.value_or(v1::Goodbye());
  if (route_.follow(convert::other_servers(goodbye.other_servers()))) return 0;
  // a server that was lost is called first, since it may have kept the sessions; one that goes away does not keep them
  const bool goes_away = goodbye_ && goodbye.reason() != v1::GOODBYE_REASON_CREDENTIALS_EXPIRING;
  if (!goes_away || servers_.size() == 1) return Backoff::bounded_s(convert::seconds(goodbye.reconnect_after()));
  route_.next();
  return 0;
}

void ClientCore::lose(const Status& status, bool will_reconnect) {
  const bool was_connected = connected_.exchange(false);
  double reconnect_at_s = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    call_ = nullptr;
    failure_ = status;
    is_lost_ = will_reconnect;
    const double asked_s = choose_server(was_connected, status);
    num_failures_ = was_connected ? 0 : num_failures_ + 1;
    const bool all_failed = lacks_token(status) || num_failures_ % servers_.size() == 0;
    const double wait_s = was_connected || all_failed ? backoff_.next_s(now_s()) * Backoff::jitter(random_) : 0;
    reconnect_at_s = now_s() + std::max(wait_s, asked_s);
    // not before all sessions know of the loss: one might be opened on the next call and then count that call as lost
    reconnect_at_s_ = std::numeric_limits<double>::infinity();
    changed_.notify_all();
  }
  if (was_connected && !closing_) {
    Event event;
    event.kind = EventKind::connection_lost;
    event.outcome.status = status;
    events_.push(std::move(event));
  }
  for (const auto& state : sessions()) {
    const std::lock_guard<std::mutex> lock(state->mutex);
    state->lose(status, will_reconnect, events_);
  }
  forget_closed();
  outbox_.clear();  // unanswered events are sent again
  const std::lock_guard<std::mutex> lock(mutex_);
  reconnect_at_s_ = reconnect_at_s;
  woken_ = true;
  changed_.notify_all();
}

void ClientCore::forget_closed() {
  for (const auto& state : sessions()) {
    bool closed = false;
    {
      const std::lock_guard<std::mutex> lock(state->mutex);
      closed = state->phase == Phase::closed;
    }
    if (!closed) continue;
    const std::lock_guard<std::mutex> lock(mutex_);
    sessions_.erase(state->id);
  }
}

void ClientCore::reconnect() {
  Status begun = fetch_catalog(ask_timeout_s_);
  if (closing_) return;
  if (begun) begun = begin_call();
  if (!begun) lose(begun, options_.reconnect && is_loss(begun));
}

void ClientCore::shut_down() {
  events_.stop();
  if (closing_.exchange(true)) return;
  std::shared_ptr<Call> call;
  std::thread worker;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    call = call_;
    worker = std::move(worker_);
    for (grpc::ClientContext* each : short_calls_) each->TryCancel();
    woken_ = true;
    changed_.notify_all();
  }
  const Status why(Code::cancelled, "CLIENT", "the client was closed");
  for (const auto& state : sessions()) {
    const std::lock_guard<std::mutex> lock(state->mutex);
    state->end(why, events_);
  }
  if (call != nullptr) call->finish();
  if (!events_.in_callback()) {
    end_calls();
    if (worker.joinable()) worker.join();
  } else if (worker.joinable()) {
    worker.detach();  // no call can end inside a callback: the worker waits for them, and keeps this alive
  }
}

void ClientCore::end_calls() {
  std::vector<std::shared_ptr<Call>> calls;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    calls = ended_calls_;
    if (call_ != nullptr) calls.push_back(call_);
  }
  for (const auto& call : calls) end_call(call);
}

void ClientCore::end_call(const std::shared_ptr<Call>& call) {
  if (call->wait_ended(kCloseGraceS)) return;
  call->cancel();
  if (call->wait_ended(kCancelGraceS)) return;
  // gRPC has not released the call and may still call back: better leak this object than let gRPC use freed memory
  static_cast<void>(new std::shared_ptr<ClientCore>(shared_from_this()));
}

}  // namespace motiongen
