#include "client/outbox.hpp"

#include "client/wire.hpp"

namespace motiongen {

void Outbox::set_limit(std::uint32_t max_request_bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  limit_ = most_event_bytes(max_request_bytes);
}

void Outbox::put(const std::string& entry) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!can_append_ || messages_.empty() || messages_.back().message.size() + entry.size() > limit_) {
    messages_.emplace_back();
  }
  messages_.back().message += entry;
  num_bytes_ += entry.size();
  can_append_ = true;
}

void Outbox::put(const v1::SessionEvent& event) {
  std::string entry;
  wire::put_bytes(v1::StreamMotionRequest::kEventsFieldNumber, event.SerializeAsString(), entry);
  put(entry);
}

void Outbox::put_alone(const v1::StreamMotionRequest& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  messages_.push_back({message.SerializeAsString()});
  num_bytes_ += messages_.back().message.size();
  can_append_ = false;
}

void Outbox::put_ping(const v1::StreamMotionRequest& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  ping_ = Waiting{message.SerializeAsString()};
}

bool Outbox::take(std::string& message) {
  std::chrono::steady_clock::time_point since;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ping_ && messages_.empty()) return false;
    Waiting& next = ping_ ? *ping_ : messages_.front();
    message = std::move(next.message);
    since = next.since;
    if (ping_) {
      ping_.reset();
    } else {
      messages_.pop_front();
      num_bytes_ -= message.size();
      if (messages_.empty()) can_append_ = false;
    }
  }
  if (on_taken_) on_taken_(std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count());
  return true;
}

bool Outbox::is_full() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return num_bytes_ > kMostWaiting;
}

void Outbox::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  messages_.clear();
  num_bytes_ = 0;
  ping_.reset();
  can_append_ = false;
}

}  // namespace motiongen
