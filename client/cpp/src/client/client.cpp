#include "motiongen/client/client.hpp"

#include "client/core.hpp"

namespace motiongen {

Result<Client> Client::connect(const ClientOptions& options) {
  auto core = std::make_shared<ClientCore>(options);
  Status connected = core->connect();
  if (!connected) return connected;
  return Client(std::move(core));
}

Client::Client(std::shared_ptr<ClientCore> core) : core_(std::move(core)) {}
Client::Client(Client&&) noexcept = default;

Client& Client::operator=(Client&& other) noexcept {
  if (this != &other) {
    if (core_ != nullptr) core_->shut_down();
    core_ = std::move(other.core_);
  }
  return *this;
}

Client::~Client() {
  if (core_ != nullptr) core_->shut_down();
}

std::shared_ptr<const Catalog> Client::catalog() const { return core_->catalog(); }

bool Client::is_connected() const { return core_->is_connected(); }

ClientStats Client::stats() const { return core_->stats(); }

Result<Session> Client::open(const SessionOptions& options) {
  auto state = core_->open(options);
  if (!state) return state.status();
  return Session(core_, std::move(state).value());
}

Result<std::vector<Clip>> Client::generate_clip(const ClipOptions& options) {
  const std::shared_ptr<ClientCore> core = core_;  // another thread or a callback may destroy the client meanwhile
  return core->generate_clip(options);
}

bool Client::next_event(Event& event) { return core_->events().take(event); }

}  // namespace motiongen
