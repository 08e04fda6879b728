// Events on their way to the application: one at a time, to its callback or to whoever asks for them.
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

  // Queue an event. May be called with other locks held: it calls nobody.
  void push(Event event);

  // Call the callback with all that waits. While another thread does, that one does it. No locks may be held.
  void dispatch();

  // The oldest event, where there is no callback.
  bool take(Event& event);

  // Whether this is the thread that a callback runs on at present.
  bool in_callback() const;

  // No callback begins from now on; one that runs on another thread has ended when this returns.
  void stop();

  std::uint64_t num_dropped() const;

 private:
  static constexpr std::size_t kMost = 65536;

  const std::function<void(const Event&)> callback_;
  mutable std::mutex mutex_;
  std::condition_variable idle_;
  std::deque<Event> events_;
  std::uint64_t num_dropped_ = 0;
  std::thread::id dispatching_;  // none: nobody is
  bool stopped_ = false;
};

}  // namespace motiongen
