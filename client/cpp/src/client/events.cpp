// Compiled with exceptions, unlike the rest of the library: the callback is the application's code.
#include "client/events.hpp"

#include "client/answers.hpp"

namespace motiongen {
namespace {

// noexcept: an exception ends the program where it is thrown. This may be one of gRPC's threads, which would swallow
// it; then the stream would hang, and so would whoever destroys the client.
void call(const std::function<void(const Event&)>& callback, const Event& event) noexcept { callback(event); }

}  // namespace

void EventQueue::push(Event event) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (stopped_) return;
  bytes_ += bytes_of(event.outcome);
  events_.push_back(std::move(event));
  while (events_.size() > kMost || (bytes_ > kMostBytes && events_.size() > 1)) {
    take_oldest();
    ++num_dropped_;
  }
}

Event EventQueue::take_oldest() {
  Event event = std::move(events_.front());
  events_.pop_front();
  bytes_ -= bytes_of(event.outcome);
  return event;
}

void EventQueue::dispatch() {
  if (!callback_) return;
  std::unique_lock<std::mutex> lock(mutex_);
  if (dispatching_ != std::thread::id()) return;
  dispatching_ = std::this_thread::get_id();
  while (!events_.empty() && !stopped_) {
    const Event event = take_oldest();
    lock.unlock();
    call(callback_, event);
    lock.lock();
  }
  dispatching_ = std::thread::id();
  idle_.notify_all();
}

bool EventQueue::take(Event& event) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (callback_ || events_.empty()) return false;
  event = take_oldest();
  return true;
}

bool EventQueue::in_callback() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return dispatching_ == std::this_thread::get_id();
}

void EventQueue::stop() {
  std::unique_lock<std::mutex> lock(mutex_);
  stopped_ = true;
  events_.clear();
  bytes_ = 0;
  if (dispatching_ == std::this_thread::get_id()) return;
  idle_.wait(lock, [this] { return dispatching_ == std::thread::id(); });
}

std::uint64_t EventQueue::num_dropped() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return num_dropped_;
}

}  // namespace motiongen
