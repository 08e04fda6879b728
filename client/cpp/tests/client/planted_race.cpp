// A deliberate race with one of gRPC's threads: ThreadSanitizer must report it, whatever is suppressed.
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <cstddef>
#include <future>
#include <memory>
#include <thread>

#include "client/call.hpp"
#include "client/outbox.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

struct Racing final : CallUser {
  Outbox outbox;
  int num_messages = 0;  // neither atomic nor guarded
  std::promise<void> ended;

  void on_message(const wire::Piece* /*pieces*/, std::size_t /*size*/) override { ++num_messages; }
  void on_call_ended(const grpc::Status& /*status*/, std::shared_ptr<Call> /*call*/) override { ended.set_value(); }
};

void race() {
  const ScriptedServer server;
  const auto user = std::make_shared<Racing>();
  v1::StreamMotionRequest hello;
  hello.mutable_hello()->set_client_agent("race");
  user->outbox.put_alone(hello);
  grpc::GenericStub stub(grpc::CreateChannel(server.options().address, grpc::InsecureChannelCredentials()));
  const auto call = Call::start(stub, {}, user->outbox, user);
  while (user->num_messages == 0) std::this_thread::yield();
  call->finish();
  user->ended.get_future().wait();
  while (!call->wait_ended(1)) continue;
}

}  // namespace
}  // namespace motiongen

int main() { motiongen::race(); }
