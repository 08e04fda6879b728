// Unanswered events are sent again on a thread of the library while the application's threads make more edits.
#include <gtest/gtest.h>

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "client/core.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr float kPerSecond = 200;
constexpr std::uint64_t kWhileLost = 120;  // more than are sent at once
constexpr std::uint64_t kEach = 20;        // of a thread, meanwhile
constexpr std::size_t kThreads = 3;
constexpr auto kLimit = std::chrono::seconds(60);

v1::SessionEvent prompt() {
  v1::SessionEvent event;
  event.mutable_edit_prompts()->add_upsert()->set_text("wave");
  return event;
}

TEST(RepeatingThreads, EveryEditIsSentOnceAndInOrder) {
  ScriptedServer server;
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<std::uint64_t> heard;
  server.add_to_catalog = [](v1::GetCatalogResponse& told) {
    told.mutable_limits()->set_max_events_per_second(kPerSecond);
  };
  server.hear = [&](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (event.has_open()) {
      stream.Write(ScriptedServer::opened(event));
    } else if (event.has_edit_prompts()) {
      const std::lock_guard<std::mutex> lock(mutex);
      heard.push_back(event.event_seq());
      changed.notify_all();
    }
  };
  const auto core = std::make_shared<ClientCore>(server.options());
  ASSERT_TRUE(core->connect());
  const auto opened = core->open({});
  ASSERT_TRUE(opened) << opened.status().message();
  SessionState& state = *opened.value();
  {
    std::unique_lock<std::mutex> lock(state.mutex);
    const auto is_open = [&state] { return state.phase == Phase::open; };
    ASSERT_TRUE(state.changed.wait_for(lock, kLimit, is_open));
    state.lose(Status(Code::unavailable, "", "cut"), true, core->events());
    for (std::uint64_t time = 0; time < kWhileLost; ++time) state.send_edit(prompt(), core->outbox(), core->events());
  }
  {
    std::unique_lock<std::mutex> lock(mutex);
    ASSERT_TRUE(changed.wait_for(lock, kLimit, [&] { return !heard.empty(); }));
    EXPECT_LT(heard.size(), kWhileLost) << "the rest must still be waiting";
  }
  std::vector<std::thread> threads;
  for (std::size_t number = 0; number < kThreads; ++number) {
    threads.emplace_back([&core, &state] {
      for (std::uint64_t time = 0; time < kEach; ++time) EXPECT_TRUE(core->edit(state, prompt()));
    });
  }
  for (std::thread& thread : threads) thread.join();
  {
    constexpr std::uint64_t kAll = kWhileLost + kThreads * kEach;
    std::unique_lock<std::mutex> lock(mutex);
    ASSERT_TRUE(changed.wait_for(lock, kLimit, [&] { return heard.size() >= kAll; }));
    ASSERT_EQ(heard.size(), kAll);
    for (std::uint64_t place = 0; place < kAll; ++place) EXPECT_EQ(heard[place], place + 2);
  }
  core->shut_down();
}

}  // namespace
}  // namespace motiongen
