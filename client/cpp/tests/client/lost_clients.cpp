// Lets COUNT clients lose their connections, and destroys or blocks them when they report it:
//   lost_clients HOST:PORT COUNT SESSIONS callback|events|slowly
// callback: the callback destroys the client. events: this thread does, which polls for events. slowly: the callback
// blocks until the client has reconnected, or for a while if it blocks the connecting thread. The server ends each
// client's stream at its last session. Exits with 1 if a client is not lost or not completely destroyed.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "motiongen/client/client.hpp"

namespace {

using motiongen::Client;
using motiongen::ClientOptions;
using motiongen::Event;
using motiongen::EventKind;

constexpr std::chrono::seconds kLimit(60);
constexpr std::chrono::milliseconds kAWhile(300);  // reconnecting takes 50 ms and two calls

// Signals when the last copy of the options is destroyed, and with it all of a client.
struct Witness {
  std::promise<void> gone;

  Witness() = default;
  Witness(const Witness&) = delete;
  Witness& operator=(const Witness&) = delete;
  ~Witness() { gone.set_value(); }
};

// What the callback destroys or asks, once it exists.
struct Held {
  std::promise<void> there;
  std::optional<Client> client;
};

// Open sessions without keeping their handles. Each learns of the loss between its report and the end of the call.
bool open(Client& client, int sessions) {
  for (int number = 0; number < sessions; ++number) {
    if (!client.open({})) return false;
  }
  return true;
}

bool lose_in_callback(const ClientOptions& given, int sessions) {
  ClientOptions options = given;
  const auto held = std::make_shared<Held>();
  auto witness = std::make_shared<Witness>();
  std::future<void> gone = witness->gone.get_future();
  options.on_event = [held, witness, there = held->there.get_future().share()](const Event& event) {
    if (event.kind != EventKind::connection_lost) return;
    there.wait();
    held->client.reset();
    std::this_thread::sleep_for(std::chrono::milliseconds(50));  // longer than everything else that is left to do
  };
  auto client = Client::connect(options);
  options.on_event = nullptr;
  witness = nullptr;
  if (!client) return false;
  held->client.emplace(std::move(client).value());
  const bool opened = open(*held->client, sessions);
  held->there.set_value();
  return opened && gone.wait_for(kLimit) == std::future_status::ready;
}

bool lose_slowly(const ClientOptions& given, int sessions) {
  ClientOptions options = given;
  std::promise<void> over;
  bool told = false;
  Held held;
  options.on_event = [&, there = held.there.get_future().share()](const Event& event) {
    if (event.kind != EventKind::connection_lost || std::exchange(told, true)) return;
    there.wait();
    const auto deadline = std::chrono::steady_clock::now() + kAWhile;
    while (!held.client->is_connected() && std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    over.set_value();
  };
  auto client = Client::connect(options);
  if (!client) return false;
  held.client.emplace(std::move(client).value());
  const bool opened = open(*held.client, sessions);
  held.there.set_value();
  return opened && over.get_future().wait_for(kLimit) == std::future_status::ready;
}

bool lose_by_events(const ClientOptions& options, int sessions) {
  auto connected = Client::connect(options);
  if (!connected) return false;
  std::optional<Client> client(std::move(connected).value());
  if (!open(*client, sessions)) return false;
  const auto deadline = std::chrono::steady_clock::now() + kLimit;
  for (Event event; event.kind != EventKind::connection_lost;) {
    if (client->next_event(event)) continue;
    if (std::chrono::steady_clock::now() > deadline) return false;
  }
  client.reset();
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  ClientOptions options;
  options.address = argv[1];
  options.connect_timeout_s = 30;
  const int sessions = std::atoi(argv[3]);
  const std::string way = argv[4];
  const auto lose = way == "callback" ? lose_in_callback : way == "events" ? lose_by_events : lose_slowly;
  for (int number = 0; number < std::atoi(argv[2]); ++number) {
    if (lose(options, sessions)) continue;
    std::fprintf(stderr, "client %d was not lost, or is still there\n", number);
    return 1;
  }
  return 0;
}
