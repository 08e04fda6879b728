// The queue of requests for the stream: events, gathered into messages no larger than the server accepts.
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
  // on_taken: called for each message taken, with the seconds that it waited since its first entry was put.
  explicit Outbox(std::function<void(double waited_s)> on_taken = nullptr) : on_taken_(std::move(on_taken)) {}

  // While more bytes than this wait, no new events are accepted: the server is not reading.
  static constexpr std::size_t kMostWaiting = Backlog::kMostWaiting;

  // The most bytes of an event that fit into a message of the server's limit.
  static std::size_t most_event_bytes(std::uint32_t max_request_bytes) {
    return max_request_bytes / 10 * std::size_t{9};
  }

  void set_limit(std::uint32_t max_request_bytes);

  // An `events` entry, encoded with its tag.
  void put(const std::string& entry);
  void put(const v1::SessionEvent& event);
  // A message about the stream itself: hello or ping.
  void put_alone(const v1::StreamMotionRequest& message);
  // A ping. It overtakes what waits and replaces a ping that has not been sent yet.
  void put_ping(const v1::StreamMotionRequest& message);
  // Take the next message; false if there is none.
  bool take(std::string& message);
  void clear();
  // Whether so much waits that new edits must be refused and reports left out.
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
