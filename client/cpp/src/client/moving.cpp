// Going to another server: one that is named where this one has no room, or any other where this one cannot serve yet.
#include <algorithm>

#include "client/core.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostAsked = 4;  // servers that are asked for one session, the first among them
constexpr char kHexDigits[] = "0123456789abcdef";
constexpr int kKeyDigits = 16;

}  // namespace

std::string ClientCore::drawn_key() {
  std::random_device source;
  std::string key;
  for (int digit = 0; digit < kKeyDigits; ++digit) key += kHexDigits[source() % 16];
  return key;
}

std::string ClientCore::routing_key() const {
  const std::lock_guard<std::mutex> lock(key_mutex_);
  return routing_key_;
}

void ClientCore::set_routing_key(std::string key) {
  const std::lock_guard<std::mutex> lock(key_mutex_);
  routing_key_ = std::move(key);
}

void ClientCore::ask_any_other() {
  if (options_.routing_key.empty()) set_routing_key(drawn_key());  // else it is the application's to choose
}

// Set the way to the first of these servers that may be asked. With mutex_ held.
bool ClientCore::choose(const std::vector<OtherServer>& servers) {
  for (const OtherServer& each : servers) {
    const auto found = std::find(options_.other_addresses.begin(), options_.other_addresses.end(), each.address);
    if (!each.address.empty() && each.address == options_.address) {
      server_ = 0;
      return true;
    }
    if (!each.address.empty() && found != options_.other_addresses.end()) {
      server_ = 1 + static_cast<std::size_t>(found - options_.other_addresses.begin());
      return true;
    }
    if (!each.routing_key.empty()) {
      set_routing_key(each.routing_key);
      return true;
    }
  }
  return false;
}

bool ClientCore::move(const SessionState& refused, const std::vector<OtherServer>& servers) {
  if (!options_.reconnect || servers.empty()) return false;
  for (const auto& state : sessions()) {
    if (state->id == refused.id) continue;
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (state->phase == Phase::open || state->phase == Phase::closing) return false;  // those that play stay
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!drop_reason_) return true;  // the next session that was refused with the first
    if (asked_.size() + 1 >= kMostAsked || !asked_.insert(replica_id_).second) return false;
    if (!choose(servers)) return false;
  }
  drop_call(Status(Code::unavailable, "OVERLOADED", "the server has no room; the client goes to another"));
  return true;
}

void ClientCore::follow(const std::shared_ptr<SessionState>& state) {
  std::vector<OtherServer> servers;
  {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (state->phase == Phase::open) {
      const std::lock_guard<std::mutex> own(mutex_);
      asked_.clear();
      return;
    }
    if (!state->refusal) return;
    servers = state->refusal->other_servers;
  }
  const bool moves = move(*state, servers);
  const std::lock_guard<std::mutex> lock(state->mutex);
  if (!moves) state->give_up_opening(events_);
  state->refusal.reset();
}

}  // namespace motiongen
