// One stream with its characters: sends their events and handles the server's messages.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>

#include "character.hpp"
#include "client/call.hpp"
#include "client/outbox.hpp"
#include "client/wire.hpp"

namespace motiongen::load {

// Shared by the streams and the loop that drives them. Locked while characters, the recorder or a stream's `put` are
// used.
struct Stage {
  std::mutex mutex;
  std::function<double()> now_s;  // seconds from the start of the run
};

class Stream final : public CallUser, public std::enable_shared_from_this<Stream> {
 public:
  Stream(Stage& stage, Run& run);

  void adopt(PlayedCharacter& character) { characters_.emplace(character.handle(), &character); }
  // Connect and send the hello.
  void start();
  // Wait for the server's hello; false if the call ended first or it took longer.
  bool wait_hello(double timeout_s);
  // Half-close the stream: the server closes the open sessions and ends the call.
  void begin_end();
  // Wait at most so long for the call to end; whether it has.
  bool wait_ended(double timeout_s) { return call_->wait_ended(timeout_s); }
  void cancel() { call_->cancel(); }

  // ---- with the stage locked

  bool lost() const { return !lost_.empty(); }
  const std::string& why_lost() const { return lost_; }
  void put(const v1::SessionEvent& event) { outbox_.put(event); }
  void put_report(const PlayedCharacter& character, double now_s);
  // Send a ping that tells the server the last round trip.
  void put_ping();
  // Record how long messages waited for gRPC to take them.
  void write_waits(Recorder& to);

  // Send what was put in the outbox.
  void flush() { call_->send(); }

  void on_message(const wire::Piece* pieces, std::size_t size) override;
  void on_call_ended(const grpc::Status& status, std::shared_ptr<Call> call) override;

 private:
  bool take_message(const wire::Piece* pieces, std::size_t size, double now_s, bool& must_flush);
  bool take_stream_event(std::uint32_t field, double now_s);
  bool take_update(const wire::Update& update, double now_s, bool& must_flush);
  void take(PlayedCharacter& character, const v1::SessionUpdate& update, double now_s);
  void take_outcome(PlayedCharacter& character, const v1::EditOutcome& outcome, double now_s);
  void take_closed(PlayedCharacter& character, const v1::SessionClosed& closed, double now_s);

  Stage& stage_;
  Run& run_;
  Outbox outbox_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<grpc::GenericStub> stub_;
  std::shared_ptr<Call> call_;
  std::shared_ptr<Call> ended_call_;
  std::unordered_map<std::uint32_t, PlayedCharacter*> characters_;
  std::condition_variable greeted_changed_;
  bool greeted_ = false;
  bool ending_ = false;
  std::string lost_;
  double round_trip_s_ = 0;  // 0: not measured
  std::string scratch_;
  std::string entry_;
  std::mutex waits_mutex_;
  bool hello_taken_ = false;
  Histogram waits_;
};

}  // namespace motiongen::load
