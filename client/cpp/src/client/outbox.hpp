// Requests that wait for the stream: events gathered into messages that the server takes.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>

#include "client/backlog.hpp"
#include "motiongen/v1/service.pb.h"

namespace motiongen {

class Outbox {
 public:
  // on_taken: hears of each message for how many seconds it waited since its first entry came.
  explicit Outbox(std::function<void(double waited_s)> on_taken = nullptr) : on_taken_(std::move(on_taken)) {}

  // Of more bytes that wait, nothing new is taken on: the server does not read.
  static constexpr std::size_t kMostWaiting = Backlog::kMostWaiting;

  // Bytes of an event that still fit into a message of the server's limit.
  static std::size_t most_event_bytes(std::uint32_t max_request_bytes) {
    return max_request_bytes / 10 * std::size_t{9};
  }

  void set_limit(std::uint32_t max_request_bytes);

  // An `events` entry, encoded with its tag.
  void put(const std::string& entry);
  void put(const v1::SessionEvent& event);
  // A message about the stream itself: hello or ping.
  void put_alone(const v1::StreamMotionRequest& message);
  // A ping, which overtakes what waits, and takes the place of one that has not gone out yet.
  void put_ping(const v1::StreamMotionRequest& message);
  // The next message; false when there is none.
  bool take(std::string& message);
  void clear();
  // Whether so much waits that what can be refused, or left out, is to be.
  bool is_full() const;

 private:
  struct Waiting {
    std::string message;
    std::chrono::steady_clock::time_point since = std::chrono::steady_clock::now();
  };

  const std::function<void(double waited_s)> on_taken_;
  mutable std::mutex mutex_;
  std::deque<Waiting> messages_;
  std::size_t num_bytes_ = 0;  // of messages_
  std::optional<Waiting> ping_;
  bool can_append_ = false;
  std::size_t limit_ = std::size_t{64} * 1024;
};

}  // namespace motiongen
