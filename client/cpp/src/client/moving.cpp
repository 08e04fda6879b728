// Going to another server if this one has no room.
#include "client/core.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostAsked = 4;  // servers asked for one session, including the first

}  // namespace

bool ClientCore::move(const SessionState& refused, const std::vector<OtherServer>& servers) {
  if (!options_.reconnect || servers.empty()) return false;
  for (const auto& state : sessions()) {
    if (state->id == refused.id) continue;
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (state->phase == Phase::open || state->phase == Phase::closing) return false;  // sessions that play stay here
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!drop_reason_) return true;  // the client is moving already: another session was refused together with this one
    if (asked_.size() + 1 >= kMostAsked || !asked_.insert(replica_id_).second) return false;
    if (!route_.go_to(servers)) return false;
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
