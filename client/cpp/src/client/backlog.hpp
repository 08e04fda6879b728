// Counts the bytes of events that wait for an answer. Events are kept until then, across losses of the connection.
#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <utility>

namespace motiongen {

// The total of all sessions of a client. May be used from any thread.
class Backlog {
 public:
  // While more bytes than this wait, no new events are accepted.
  static constexpr std::size_t kMostWaiting = std::size_t{64} << 20;

  bool is_full() const { return num_bytes_ > kMostWaiting; }

 private:
  friend class BacklogShare;
  std::atomic<std::size_t> num_bytes_{0};
};

// Counts the bytes of one event for as long as this object lives.
class BacklogShare {
 public:
  BacklogShare() = default;
  // backlog: may be null.
  BacklogShare(std::shared_ptr<Backlog> backlog, std::size_t num_bytes)
      : backlog_(std::move(backlog)), num_bytes_(num_bytes) {
    if (backlog_ != nullptr) backlog_->num_bytes_ += num_bytes_;
  }
  BacklogShare(BacklogShare&&) noexcept = default;
  BacklogShare& operator=(BacklogShare&& other) noexcept {
    BacklogShare(std::move(other)).swap(*this);
    return *this;
  }
  ~BacklogShare() {
    if (backlog_ != nullptr) backlog_->num_bytes_ -= num_bytes_;
  }

 private:
  void swap(BacklogShare& other) noexcept {
    std::swap(backlog_, other.backlog_);
    std::swap(num_bytes_, other.num_bytes_);
  }

  std::shared_ptr<Backlog> backlog_;
  std::size_t num_bytes_ = 0;
};

}  // namespace motiongen
