// The order of events when a call is lost.
#include <gtest/gtest.h>

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "client/core.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kPingPeriodS = 0.1;  // of a connected client; another call is made after about half of that
constexpr int kPings = 4;
constexpr auto kLimit = std::chrono::seconds(60);

// Whether another call is made after the connection was lost, seen by its request for a token.
struct Asked {
  std::mutex mutex;
  std::condition_variable changed;
  bool counts = false;
  bool is_asked = false;

  std::string token() {
    const std::lock_guard<std::mutex> lock(mutex);
    is_asked = is_asked || counts;
    changed.notify_all();
    return "token";
  }

  void begin() {
    const std::lock_guard<std::mutex> lock(mutex);
    counts = true;
  }

  bool has_come() {
    const std::lock_guard<std::mutex> lock(mutex);
    return is_asked;
  }

  bool wait() {
    std::unique_lock<std::mutex> lock(mutex);
    return changed.wait_for(lock, kLimit, [this] { return is_asked; });
  }
};

// A second client on the same clock. After its wait, another call would have been made long ago.
class Beside {
 public:
  Beside() : client_(Client::connect(options())) {}

  bool is_there() const { return static_cast<bool>(client_); }
  void wait() const {
    const int before = server_.num_pings;
    while (server_.num_pings < before + kPings) std::this_thread::yield();
  }

 private:
  ClientOptions options() const {
    ClientOptions made = server_.options();
    made.ping_period_s = kPingPeriodS;
    return made;
  }

  ScriptedServer server_;
  Result<Client> client_;
};

TEST(LostCall, NextCallIsMadeOnlyAfterAllSessionsKnowOfTheLoss) {
  ScriptedServer server;
  const Beside beside;
  ASSERT_TRUE(beside.is_there());
  Asked asked;
  ClientOptions options = server.options();
  options.token_source = [&asked] { return Result<std::string>(asked.token()); };
  const auto core = std::make_shared<ClientCore>(options);
  ASSERT_TRUE(core->connect());
  const auto opened = core->open({});
  ASSERT_TRUE(opened) << opened.status().message();
  SessionState& state = *opened.value();
  {
    const std::lock_guard<std::mutex> lock(state.mutex);  // so that the session cannot learn of the loss yet
    asked.begin();
    server.end();
    while (core->is_connected()) std::this_thread::yield();
    beside.wait();
    EXPECT_FALSE(asked.has_come());
    EXPECT_EQ(state.phase, Phase::opening);
  }
  EXPECT_TRUE(asked.wait());
  core->shut_down();
}

}  // namespace
}  // namespace motiongen
