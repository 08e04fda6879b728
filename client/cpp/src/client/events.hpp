// The queue of events for the application: given to its callback, one at a time, or taken by `next_event`.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

#include "motiongen/client/types.hpp"

namespace motiongen {

class EventQueue {
 public:
  explicit EventQueue(std::function<void(const Event&)> callback) : callback_(std::move(callback)) {}

  // Queue an event. May be called with other locks held, since it runs no callback.
  void push(Event event);

  // Call the callback with all queued events, unless another thread is already doing so, which then does it. No locks
  // may be held.
  void dispatch();

  // Take the oldest event, where there is no callback.
  bool take(Event& event);

  // Whether this thread is running a callback.
  bool in_callback() const;

  // No callback begins from now on, and one running on another thread has ended when this returns.
  void stop();

  std::uint64_t num_dropped() const;

 private:
  static constexpr std::size_t kMost = 65536;
  static constexpr std::size_t kMostBytes = std::size_t{1} << 26;

  Event take_oldest();  // under mutex_

  const std::function<void(const Event&)> callback_;
  mutable std::mutex mutex_;
  std::condition_variable idle_;
  std::deque<Event> events_;
  std::size_t bytes_ = 0;  // of the events' outcomes
  std::uint64_t num_dropped_ = 0;
  std::thread::id dispatching_;  // none: no callback is running
  bool stopped_ = false;
};

}  // namespace motiongen
