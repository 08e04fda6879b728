// What is done in which order when a call is lost.
#include <gtest/gtest.h>

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>

#include "client/core.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr auto kNever = std::chrono::seconds(1);  // a call is made again after a twentieth of that
constexpr auto kLimit = std::chrono::seconds(60);

// Whether a call is asked for once the line is lost: its token is.
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

  bool wait(std::chrono::seconds most) {
    std::unique_lock<std::mutex> lock(mutex);
    return changed.wait_for(lock, most, [this] { return is_asked; });
  }
};

TEST(LostCall, NoOtherIsMadeBeforeAllSessionsHaveHeard) {
  ScriptedServer server;
  Asked asked;
  ClientOptions options = server.options();
  options.token_source = [&asked] { return Result<std::string>(asked.token()); };
  const auto core = std::make_shared<ClientCore>(options);
  ASSERT_TRUE(core->connect());
  const auto opened = core->open({});
  ASSERT_TRUE(opened) << opened.status().message();
  SessionState& state = *opened.value();
  {
    const std::lock_guard<std::mutex> lock(state.mutex);  // so that it cannot hear yet
    asked.begin();
    server.end();
    EXPECT_FALSE(asked.wait(kNever));
    EXPECT_EQ(state.phase, Phase::opening);
  }
  EXPECT_TRUE(asked.wait(kLimit));
  core->shut_down();
}

}  // namespace
}  // namespace motiongen
