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
  can_append_ = false;
}

bool Outbox::take(std::string& message) {
  std::chrono::steady_clock::time_point since;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (messages_.empty()) return false;
    message = std::move(messages_.front().message);
    since = messages_.front().since;
    messages_.pop_front();
    if (messages_.empty()) can_append_ = false;
  }
  if (on_taken_) on_taken_(std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count());
  return true;
}

void Outbox::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  messages_.clear();
  can_append_ = false;
}

}  // namespace motiongen
