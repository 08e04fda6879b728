// The way of a client to a server: the same address and key with every call, until another server is wanted.
#pragma once

#include <cstddef>
#include <deque>
#include <mutex>
#include <string>
#include <vector>

#include "motiongen/client/types.hpp"

namespace motiongen {

// Metadata by which a proxy can bring all calls of one client to one server, which has its sessions.
inline constexpr char kRoutingKey[] = "x-motiongen-key";

// May be used from any thread; takes no other lock.
class Route {
 public:
  // addresses: the client's own, then the others that it may go to. key: the application's; empty: one is drawn.
  Route(std::vector<std::string> addresses, std::string key);

  // Whether a key can be sent: letters, digits, -, . and _.
  static bool is_key(const std::string& text);

  std::size_t server() const;  // which of the addresses
  std::string key() const;

  // To the next address.
  void next();
  // To the first of these servers that the client may go to, for want of room at its own. An application's key stays.
  // False: there is none.
  bool go_to(const std::vector<OtherServer>& servers);
  // The same where its own goes away, and the others are for `pass_over`.
  bool follow(const std::vector<OtherServer>& servers);
  // To the next server that was named, since this one serves nobody; where none is left, to the next address, by
  // another key where the server there is only starting: what it had is gone from it, and a proxy may have others.
  void pass_over(bool is_starting);

 private:
  // key: empty leaves it.
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
