// The core of a client: its channels, its present call, its sessions, and the worker thread that does what is due.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "client/backlog.hpp"
#include "client/backoff.hpp"
#include "client/call.hpp"
#include "client/call_metadata.hpp"
#include "client/convert.hpp"
#include "client/events.hpp"
#include "client/outbox.hpp"
#include "client/route.hpp"
#include "client/session_state.hpp"
#include "motiongen/client/client.hpp"

namespace motiongen {

inline constexpr double kAskTimeoutS = 5;

// Seconds of a monotonic clock.
double now_s();

// Whether calls carry a token.
bool has_token(const ClientOptions& options);
// The client's own address, then the other ones.
std::vector<std::string> addresses_of(const ClientOptions& options);

// The context of a short call, with deadline and metadata. Closing the client cancels it.
class ShortCall {
 public:
  // Calls the token source, so no lock may be held. `made`: OK, or why the call cannot be made.
  ShortCall(class ClientCore& core, double timeout_s);
  ~ShortCall();
  ShortCall(const ShortCall&) = delete;
  ShortCall& operator=(const ShortCall&) = delete;

  grpc::ClientContext context;
  Status made;

 private:
  ClientCore& core_;
};

class ClientCore final : public CallUser, public std::enable_shared_from_this<ClientCore> {
 public:
  // ask_timeout_s: for the catalogue, and for the hello of one of several servers.
  explicit ClientCore(ClientOptions options, double ask_timeout_s = kAskTimeoutS);

  // ---- for Client

  Status connect();
  void shut_down();
  Result<std::shared_ptr<SessionState>> open(const SessionOptions& options);
  std::shared_ptr<const Catalog> catalog() const;
  ClientStats stats() const;
  Result<std::vector<Clip>> generate_clip(const ClipOptions& options);
  bool is_connected() const { return connected_; }

  // ---- for Session

  // Send an event of a session. FAILED_PRECONDITION if the session is closed.
  Result<EditId> edit(SessionState& state, v1::SessionEvent event);
  // The same; `make` returns the event and runs while the session is locked.
  template <class Make>
  Result<EditId> edit_with(SessionState& state, Make make);
  void flush();  // send what waits in the outbox
  void wake();   // let the worker look at what is due
  EventQueue& events() { return events_; }
  Outbox& outbox() { return outbox_; }
  // RESOURCE_EXHAUSTED (OUTBOX_FULL) if too much still waits for the server to read or answer it.
  Status check_room() const;
  double report_period_s() const { return 1 / options_.report_hz; }

  // ---- for the call

  void on_message(const wire::Piece* pieces, std::size_t size) override;
  void on_call_ended(const grpc::Status& status, std::shared_ptr<Call> call) override;

 private:
  friend class ShortCall;

  Result<v1::OpenSession> opening_of(const SessionOptions& options) const;

  Status check_options() const;

  void make_channels();

  // connection.cpp: calls, their loss, and reconnecting
  Status try_connect(double deadline_s);
  Status fetch_catalog(double timeout_s);
  Status begin_call();
  void reconnect();
  void lose(const Status& status, bool will_reconnect);
  double choose_server(bool was_connected, const Status& why);
  void forget_closed();
  // Wait for the present call, and for lost ones whose end is still being reported: gRPC's threads use this object
  // until then.
  void end_calls();
  void end_call(const std::shared_ptr<Call>& call);

  // worker.cpp: what is done by the clock
  void work();
  void tick(double now);
  void report(double now);
  void send_ping(double now);
  bool is_silent(double now);

  bool take_stream_event(const wire::Cursor& message);
  void take_hello(const v1::ServerHello& hello);
  void take_pong(std::int64_t pinged_ns);
  void take_goodbye(const v1::Goodbye& goodbye);
  void drop_call(const Status& status);
  // Returns false if it cannot be read.
  bool take_update(const wire::Update& update, double now);
  static bool is_opening(const SessionState& state);
  bool knows_rig_of(const v1::SessionOpened& opened) const;
  std::vector<std::shared_ptr<SessionState>> sessions() const;
  void open_waiting(double now);

  // moving.cpp: going to another server if this one has no room
  bool move(const SessionState& refused, const std::vector<OtherServer>& servers);
  void follow(const std::shared_ptr<SessionState>& state);

  const ClientOptions options_;
  const double ask_timeout_s_;
  CallMetadata metadata_;
  EventQueue events_;
  Outbox outbox_;
  const std::shared_ptr<Backlog> backlog_ = std::make_shared<Backlog>();
  // One for each address, made once; gRPC connects it at its first use.
  struct Server {
    std::shared_ptr<grpc::Channel> channel;
    std::unique_ptr<grpc::GenericStub> stub;
  };
  const Server& server() const { return servers_[route_.server()]; }
  std::vector<Server> servers_;
  Route route_;
  std::atomic<bool> connected_{false};
  std::atomic<bool> ever_connected_{false};
  std::atomic<bool> closing_{false};
  std::atomic<bool> wants_catalog_{false};  // the server refused a model or a rig, so the catalogue is out of date
  std::atomic<std::uint32_t> next_session_{1};
  std::atomic<std::uint64_t> num_messages_{0};
  std::atomic<std::uint64_t> num_bytes_{0};
  std::atomic<std::uint64_t> num_chunks_{0};
  std::atomic<std::uint32_t> num_reconnects_{0};
  std::atomic<double> round_trip_s_{0};
  std::atomic<double> heard_at_s_{0};
  std::string scratch_;  // for the call's reads, which come one at a time

  // while it is held, only the locks of `outbox_`, `events_`, `route_` and calls may be taken
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::shared_ptr<const Catalog> catalog_;
  std::shared_ptr<Call> call_;
  std::vector<std::shared_ptr<Call>> ended_calls_;  // released by the next call after `wait_ended`, or with this
  std::set<grpc::ClientContext*> short_calls_;      // those under way, which closing cancels
  std::unordered_map<std::uint32_t, std::shared_ptr<SessionState>> sessions_;
  std::string replica_id_;              // of the server of the present call
  std::optional<v1::Goodbye> goodbye_;  // of the present call
  std::set<std::string> asked_;         // servers that had no room since a session was last opened
  Status failure_;                      // of the last call
  Status drop_reason_;                  // why the present call was cancelled here
  bool is_lost_ = false;                // there is no call, but a time to make another
  double reconnect_at_s_ = 0;
  Backoff backoff_;
  std::size_t num_failures_ = 0;  // of attempts to connect since the last loss
  double next_ping_s_ = 0;
  std::int64_t pinged_ns_ = 0;  // when the last ping was sent; below: when the last one that was answered was sent
  std::int64_t ponged_ns_ = 0;
  double unanswered_since_s_ = 0;  // when the first unanswered ping was sent; 0: all are answered
  bool woken_ = false;
  std::thread worker_;
  std::minstd_rand random_{std::random_device{}()};
};

template <class Make>
Result<EditId> ClientCore::edit_with(SessionState& state, Make make) {
  EditId edit = 0;
  {
    const std::lock_guard<std::mutex> lock(state.mutex);
    if (state.phase == Phase::closed || state.phase == Phase::closing) {
      return Status(Code::failed_precondition, "SESSION_CLOSED",
                    "the session has ended (" + state.ended.reason() + "): " + state.ended.message());
    }
    v1::SessionEvent event = make();
    Status fits = convert::check_size("edit", event, catalog()->limits);
    if (fits) fits = check_room();
    if (!fits) return fits;
    edit = state.send_edit(std::move(event), outbox_, events_);
  }
  flush();
  return edit;
}

}  // namespace motiongen
