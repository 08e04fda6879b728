// One StreamMotion call on gRPC's callback API: it sends what is in an outbox, and reports messages and its own end.
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

// Receives what happens on a call. Its methods are called on gRPC's threads, one at a time for one call.
class CallUser {
 public:
  virtual ~CallUser() = default;
  // A message, in pieces that are valid until this returns. `size`: their total in bytes.
  virtual void on_message(const wire::Piece* pieces, std::size_t size) = 0;
  // `call` must be released on another thread, and only after `wait_ended`: the call itself is running this method.
  virtual void on_call_ended(const grpc::Status& status, std::shared_ptr<class Call> call) = 0;
};

// Keeps itself and its user alive until it has ended.
class Call final : public grpc::ClientBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer> {
 public:
  // Begin a call that sends what is in the outbox, which is part of `user` and so outlives the call.
  static std::shared_ptr<Call> start(grpc::GenericStub& stub, const Metadata& metadata, Outbox& outbox,
                                     std::shared_ptr<CallUser> user);

  // Send what waits in the outbox, now or after the message that is being sent.
  void send();
  // Send what waits, then half-close the stream: the server closes the sessions and ends the call.
  void finish();
  void cancel();
  // Wait at most this long for the call to end. True: it has told its user, and touches neither its user nor itself any
  // more.
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
