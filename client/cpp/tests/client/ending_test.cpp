// Ending a client or a session while something else begins, on a server that chooses the moment.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kLimitS = 60;

// So many targets that converting them to a message takes a while.
SessionOptions big() {
  SessionOptions options;
  for (std::uint64_t frame = 0; frame < 5000; ++frame) options.targets.emplace_back(Waypoint{frame, 0, 0, {}, {}});
  return options;
}

TEST(Ending, SessionOpenedWhileTheConnectionIsLostForGoodEndsOrIsRefused) {
  const SessionOptions wanted = big();
  for (int trial = 0; trial < 10; ++trial) {
    ScriptedServer server;
    ClientOptions options = server.options();
    options.reconnect = false;
    auto client = Client::connect(options);
    ASSERT_TRUE(client) << client.status().message();
    std::atomic<int> num_opened{0};
    std::vector<Session> sessions;
    std::thread opening([&] {
      for (auto session = client->open(wanted); session; session = client->open(wanted)) {
        sessions.push_back(std::move(session).value());
        ++num_opened;
      }
    });
    while (num_opened == 0) std::this_thread::yield();
    server.end();
    opening.join();
    for (Session& session : sessions) {
      const auto told = session.wait_open(kLimitS);
      ASSERT_FALSE(told);
      ASSERT_NE(told.status().reason(), "TIMEOUT") << "the session never ended";
    }
    EXPECT_EQ(client->open(wanted).status().reason(), "CLIENT_CLOSED");
  }
}

TEST(Ending, ClientMayBeDestroyedWhileItReconnectsAndThreadsWait) {
  for (int trial = 0; trial < 10; ++trial) {
    ScriptedServer server;
    server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
      if (!event.has_open()) return;
      stream.Write(ScriptedServer::opened(event));
    };
    std::promise<void> lost;
    ClientOptions options = server.options();
    options.on_event = [&lost, told = false](const Event& event) mutable {
      if (event.kind == EventKind::connection_lost && !std::exchange(told, true)) lost.set_value();
    };
    std::optional<Client> client(std::move(Client::connect(options)).value());
    std::vector<Session> sessions;
    for (int number = 0; number < 4; ++number) {
      sessions.push_back(std::move(client->open({})).value());
      ASSERT_TRUE(sessions.back().wait_open(kLimitS));
    }
    server.end();
    lost.get_future().wait();
    std::vector<std::thread> threads;
    for (std::size_t number = 0; number < 3; ++number) {
      threads.emplace_back(
          [&session = sessions[number]] { EXPECT_EQ(session.wait_frame(1'000'000, HUGE_VAL).reason(), "CLIENT"); });
    }
    threads.emplace_back([&sessions] { EXPECT_TRUE(sessions[3].close()); });
    client.reset();
    for (std::thread& thread : threads) thread.join();
    EXPECT_FALSE(sessions[0].set_velocity(0, 1, 1));
  }
}

// A token source. While `waits` is set, it returns only after the client was destroyed.
struct Moment {
  std::promise<void> asked;
  std::promise<void> destroyed;
  std::atomic<bool> waits{false};
  std::weak_ptr<int> witness;
  bool is_whole = false;

  std::string token() {
    if (!waits.exchange(false)) return "token";
    asked.set_value();
    destroyed.get_future().wait();
    is_whole = !witness.expired();
    return "token";
  }
};

TEST(Ending, ClientMayBeDestroyedWhileAnotherThreadGeneratesAClip) {
  ScriptedServer server;
  server.add_to_catalog = [](v1::GetCatalogResponse& catalog) {
    catalog.mutable_limits()->set_max_clip_frames(10);
    catalog.mutable_limits()->set_max_clip_samples(1);
  };
  Moment moment;
  ClientOptions options = server.options();
  options.token_source = [&moment] { return Result<std::string>(moment.token()); };
  auto witness = std::make_shared<int>();
  moment.witness = witness;
  options.on_event = [witness](const Event& /*event*/) {};
  std::optional<Client> client(std::move(Client::connect(options)).value());
  options.on_event = nullptr;
  witness = nullptr;
  moment.waits = true;
  std::thread making([&client] {
    ClipOptions wanted;
    wanted.num_frames = 1;
    EXPECT_EQ(client->generate_clip(wanted).status().code(), Code::cancelled);
  });
  moment.asked.get_future().wait();
  client.reset();
  moment.destroyed.set_value();
  making.join();
  EXPECT_TRUE(moment.is_whole) << "the client was destroyed while it generated the clip";
  EXPECT_TRUE(moment.witness.expired()) << "the client is destroyed after the clip";
}

}  // namespace
}  // namespace motiongen
