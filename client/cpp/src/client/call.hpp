// One call of StreamMotion on gRPC's callback API: bytes out of an outbox, messages in, and its end.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "client/call_metadata.hpp"
#include "client/outbox.hpp"
#include "client/wire.hpp"

namespace motiongen {

// Who hears of a call. Called on gRPC's threads, one method at a time for one call.
class CallUser {
 public:
  virtual ~CallUser() = default;
  // A message, in pieces that are there until this returns. `size`: of all of them.
  virtual void on_message(const wire::Piece* pieces, std::size_t size) = 0;
  // `call` is to be let go on another thread, and only once `wait_ended` says so: it calls this.
  virtual void on_call_ended(const grpc::Status& status, std::shared_ptr<class Call> call) = 0;
};

// Keeps itself, and its user, alive until it has ended.
class Call final : public grpc::ClientBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer> {
 public:
  // Begin a call that sends what is in the outbox, which outlives it as part of `user`.
  static std::shared_ptr<Call> start(grpc::GenericStub& stub, const Metadata& metadata, Outbox& outbox,
                                     std::shared_ptr<CallUser> user);

  // Send what waits in the outbox, now or when what is being sent has gone.
  void send();
  // Send what waits, then tell the server that no more comes: it closes the sessions and ends the call.
  void finish();
  void cancel();
  // Whether it has ended, after at most so long: its user has heard of it, and it touches neither its user nor itself
  // any more.
  bool wait_ended(double timeout_s);

  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnDone(const grpc::Status& status) override;

 private:
  Call(Outbox& outbox, std::shared_ptr<CallUser> user) : outbox_(outbox), user_(std::move(user)) {}
  void send_next();  // with mutex_ held

  Outbox& outbox_;
  std::shared_ptr<CallUser> user_;
  std::shared_ptr<Call> self_;
  grpc::ClientContext context_;

  std::mutex mutex_;
  std::condition_variable ended_changed_;
  bool writing_ = false;
  bool finishing_ = false;
  bool no_more_writes_ = false;
  bool ended_ = false;

  grpc::ByteBuffer received_;
  grpc::ByteBuffer sent_;
  std::string message_;
  std::vector<grpc::Slice> slices_;
  std::vector<wire::Piece> pieces_;
};

}  // namespace motiongen
