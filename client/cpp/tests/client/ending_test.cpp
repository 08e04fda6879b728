// What ends while something else begins, on a server that chooses the moment.
#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <utility>
#include <vector>

#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kLimitS = 60;

// So many targets take a while to be made into a message.
SessionOptions big() {
  SessionOptions options;
  for (std::uint64_t frame = 0; frame < 5000; ++frame) options.targets.emplace_back(Waypoint{frame, 0, 0, {}, {}});
  return options;
}

TEST(Ending, ASessionThatOpensWhileTheLineIsLostForGoodEndsTooOrIsRefused) {
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
      ASSERT_NE(told.status().reason(), "TIMEOUT") << "nobody ends it";
    }
    EXPECT_EQ(client->open(wanted).status().reason(), "CLIENT_CLOSED");
  }
}

}  // namespace
}  // namespace motiongen
