#include "client/call.hpp"

#include <chrono>

#if defined(__SANITIZE_THREAD__)
#include <sanitizer/tsan_interface.h>
#endif

namespace motiongen {
namespace {

// ThreadSanitizer cannot see that the start, the reads and the end happen one after another: the synchronisation is
// inside gRPC's libraries.
void begin_step([[maybe_unused]] Call* call) {
#if defined(__SANITIZE_THREAD__)
  __tsan_acquire(call);
#endif
}

void end_step([[maybe_unused]] Call* call) {
#if defined(__SANITIZE_THREAD__)
  __tsan_release(call);
#endif
}

}  // namespace

std::shared_ptr<Call> Call::start(grpc::GenericStub& stub, const Metadata& metadata, Outbox& outbox,
                                  std::shared_ptr<CallUser> user) {
  std::shared_ptr<Call> call(new Call(outbox, std::move(user)));
  call->self_ = call;
  for (const auto& [key, text] : metadata) call->context_.AddMetadata(key, text);
  stub.PrepareBidiStreamingCall(&call->context_, "/motiongen.v1.MotionService/StreamMotion", grpc::StubOptions(),
                                call.get());
  end_step(call.get());
  call->AddHold();  // lets writes begin outside the call's own callbacks; removed when nothing more can be read
  call->StartRead(&call->received_);
  call->StartCall();
  call->send();
  return call;
}

void Call::send() {
  const std::lock_guard<std::mutex> lock(mutex_);
  send_next();
}

void Call::finish() {
  const std::lock_guard<std::mutex> lock(mutex_);
  finishing_ = true;
  send_next();
}

void Call::cancel() { context_.TryCancel(); }

bool Call::wait_ended(double timeout_s) {
  std::unique_lock<std::mutex> lock(mutex_);
  return ended_changed_.wait_for(lock, std::chrono::duration<double>(timeout_s), [this] { return ended_; });
}

void Call::send_next() {
  if (writing_ || no_more_writes_) return;
  if (outbox_.take(message_)) {
    const grpc::Slice slice(message_);
    sent_ = grpc::ByteBuffer(&slice, 1);
    writing_ = true;
    StartWrite(&sent_);
  } else if (finishing_) {
    no_more_writes_ = true;
    StartWritesDone();
  }
}

void Call::OnReadDone(bool ok) {
  begin_step(this);
  if (!ok) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      no_more_writes_ = true;
    }
    RemoveHold();
    return;
  }
  slices_.clear();
  pieces_.clear();
  std::size_t size = 0;
  if (received_.Dump(&slices_).ok()) {
    for (const grpc::Slice& slice : slices_) {
      pieces_.push_back({slice.begin(), slice.size()});
      size += slice.size();
    }
    user_->on_message(pieces_.data(), size);
  }
  slices_.clear();
  received_.Clear();
  end_step(this);
  StartRead(&received_);
}

void Call::OnWriteDone(bool ok) {
  const std::lock_guard<std::mutex> lock(mutex_);
  writing_ = false;
  if (ok) send_next();
}

void Call::OnDone(const grpc::Status& status) {
  begin_step(this);
  // Neither this call nor its user may be destroyed on this thread, which is one of gRPC's: both hold the channel, and
  // when the last reference to the last channel goes, gRPC 1.51 joins its own threads. So the user takes over the call,
  // and whoever releases either of them first waits for the end (`wait_ended`), even if the user was done with the call
  // long before.
  user_->on_call_ended(status, std::move(self_));
  user_ = nullptr;
  const std::lock_guard<std::mutex> lock(mutex_);
  ended_ = true;
  ended_changed_.notify_all();
}

}  // namespace motiongen
