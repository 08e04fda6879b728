#include "client/route.hpp"

#include <algorithm>
#include <random>
#include <utility>

namespace motiongen {
namespace {

constexpr char kHexDigits[] = "0123456789abcdef";
constexpr char kKeyCharacters[] = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-._";
constexpr int kKeyDigits = 16;
constexpr std::size_t kMostKeyLength = 256;  // of a key named by a server, since it goes with every call

std::string drawn_key() {
  std::random_device source;
  std::string key;
  for (int digit = 0; digit < kKeyDigits; ++digit) key += kHexDigits[source() % 16];
  return key;
}

}  // namespace

Route::Route(std::vector<std::string> addresses, std::string key)
    : addresses_(std::move(addresses)),
      has_drawn_key_(key.empty()),
      key_(has_drawn_key_ ? drawn_key() : std::move(key)) {}

bool Route::is_key(const std::string& text) { return text.find_first_not_of(kKeyCharacters) == std::string::npos; }

std::size_t Route::server() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return server_;
}

std::string Route::key() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return key_;
}

void Route::next() {
  const std::lock_guard<std::mutex> lock(mutex_);
  server_ = (server_ + 1) % addresses_.size();
}

bool Route::go_to(const std::vector<OtherServer>& servers) {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::deque<Way> found = ways(servers);
  return take_first(found);
}

bool Route::follow(const std::vector<OtherServer>& servers) {
  const std::lock_guard<std::mutex> lock(mutex_);
  named_ = ways(servers);
  return take_first(named_);
}

void Route::pass_over(bool is_starting) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (take_first(named_)) return;
  server_ = (server_ + 1) % addresses_.size();
  if (is_starting && has_drawn_key_) key_ = drawn_key();
}

// A server is reached by its own address if that is one of the client's; else by its key at the client's own address,
// unless the application has chosen a key.
std::deque<Route::Way> Route::ways(const std::vector<OtherServer>& servers) const {
  std::deque<Way> found;
  for (const OtherServer& each : servers) {
    const auto known = std::find(addresses_.begin(), addresses_.end(), each.address);
    const std::string& key = each.routing_key;
    if (known != addresses_.end()) {
      found.push_back({static_cast<std::size_t>(known - addresses_.begin()), ""});
    } else if (has_drawn_key_ && !key.empty() && key.size() <= kMostKeyLength && is_key(key)) {
      found.push_back({0, key});
    }
  }
  return found;
}

bool Route::take_first(std::deque<Way>& ways) {
  if (ways.empty()) return false;
  server_ = ways.front().server;
  if (!ways.front().key.empty()) key_ = std::move(ways.front().key);
  ways.pop_front();
  return true;
}

}  // namespace motiongen
