// Which server a client calls: the same address and routing key with every call, until it goes to another server.
#pragma once

#include <cstddef>
#include <deque>
#include <mutex>
#include <string>
#include <vector>

#include "motiongen/client/types.hpp"

namespace motiongen {

// The metadata by which a proxy can route all calls of one client to the server that has its sessions.
inline constexpr char kRoutingKey[] = "x-motiongen-key";

// May be used from any thread; takes no other lock.
class Route {
 public:
  // addresses: the client's own, then the others that it may go to. key: the application's; empty: a random one.
  Route(std::vector<std::string> addresses, std::string key);

  // Whether a text can be a key: letters, digits, -, . and _.
  static bool is_key(const std::string& text);

  std::size_t server() const;  // index of the address
  std::string key() const;

  // Go to the next address.
  void next();
  // Go to the first of these servers that the client may go to, because its own has no room. An application's key
  // stays. False if there is none.
  bool go_to(const std::vector<OtherServer>& servers);
  // The same because its own server goes away; the rest of these servers are kept for `pass_over`.
  bool follow(const std::vector<OtherServer>& servers);
  // Leave a server that does not serve: go to the next of those that `follow` kept, or else to the next address. If the
  // server is only starting (is_starting), also draw another key: it has lost its sessions anyway, and a proxy may have
  // other servers.
  void pass_over(bool is_starting);

 private:
  // key: empty keeps the present one.
  struct Way {
    std::size_t server;
    std::string key;
  };
  std::deque<Way> ways(const std::vector<OtherServer>& servers) const;
  bool take_first(std::deque<Way>& ways);

  const std::vector<std::string> addresses_;
  const bool has_drawn_key_;
  mutable std::mutex mutex_;
  std::size_t server_ = 0;
  std::string key_;
  std::deque<Way> named_;
};

}  // namespace motiongen
