// A session: constructed, moved, closed.
#include "motiongen/client/session.hpp"

#include "client/core.hpp"

namespace motiongen {

Session::Session(std::shared_ptr<ClientCore> core, std::shared_ptr<SessionState> state)
    : core_(std::move(core)), state_(std::move(state)) {}
Session::Session(Session&&) noexcept = default;

Session& Session::operator=(Session&& other) noexcept {
  if (this != &other) {
    if (state_ != nullptr) static_cast<void>(close());
    core_ = std::move(other.core_);
    state_ = std::move(other.state_);
  }
  return *this;
}

Session::~Session() {
  if (state_ != nullptr) static_cast<void>(close());
}

std::uint32_t Session::id() const { return state_->id; }

Status Session::close() {
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (state_->phase == Phase::closed || state_->phase == Phase::closing) return {};
    const bool must_tell = state_->phase != Phase::waiting;
    if (must_tell) state_->send_close(core_->outbox());
    state_->phase = Phase::closing;
    if (!must_tell) state_->end_as_wished(core_->events());
    state_->changed.notify_all();
  }
  core_->flush();
  return {};
}

}  // namespace motiongen
