// Callbacks, and objects used from many threads or destroyed meanwhile, on a real server.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <memory>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "live_server.hpp"
#include "motiongen/client/client.hpp"

namespace motiongen {
namespace {

TEST(Threads, EventsReachTheCallbackOneAtATime) {
  std::atomic<int> inside{0};
  std::atomic<bool> overlapped{false};
  std::promise<void> both;
  std::atomic<int> opened{0};
  ClientOptions options = server();
  options.on_event = [&](const Event& event) {
    if (inside.fetch_add(1) != 0) overlapped = true;
    if (event.kind == EventKind::opened && opened.fetch_add(1) == 1) both.set_value();
    --inside;
  };
  auto client = Client::connect(options);
  ASSERT_TRUE(client);
  auto one = client->open(walking());
  auto two = client->open(walking());
  ASSERT_EQ(both.get_future().wait_for(std::chrono::seconds(60)), std::future_status::ready);
  EXPECT_FALSE(overlapped);
  Event event;
  EXPECT_FALSE(client->next_event(event)) << "they went to the callback";
}

TEST(Threads, ClientMayBeDestroyedInsideItsCallback) {
  for (int trial = 0; trial < 5; ++trial) {
    auto held = std::make_shared<std::optional<Client>>();
    auto session = std::make_shared<std::optional<Session>>();
    std::promise<bool> ready;
    std::promise<Status> waited;
    std::promise<void> gone;
    std::shared_future<bool> go(ready.get_future());
    ClientOptions options = server();
    options.on_event = [&, held, session, go](const Event& event) {
      if (event.kind != EventKind::opened || !go.get()) return;
      waited.set_value((*session)->wait_frame(1'000'000, 1));
      session->reset();
      held->reset();
      gone.set_value();
    };
    auto client = Client::connect(options);
    ASSERT_TRUE(client);
    held->emplace(std::move(client).value());
    auto opened = (*held)->open(walking());
    ASSERT_TRUE(opened);
    session->emplace(std::move(opened).value());
    ready.set_value(true);
    EXPECT_EQ(waited.get_future().get().reason(), "IN_CALLBACK");
    gone.get_future().wait();
    EXPECT_FALSE(held->has_value());
  }
}

TEST(Threads, NoCallbackRunsAfterTheClientIsDestroyed) {
  for (int trial = 0; trial < 10; ++trial) {
    auto alive = std::make_unique<std::atomic<int>>(0);
    ClientOptions options = server();
    options.on_event = [counted = alive.get()](const Event&) { ++*counted; };
    auto client = Client::connect(options);
    ASSERT_TRUE(client);
    std::vector<Session> sessions;
    for (int number = 0; number < 5; ++number) {
      auto session = client->open(walking());
      ASSERT_TRUE(session);
      sessions.push_back(std::move(session).value());
    }
    client.value() = std::move(Client::connect(server())).value();
    alive.reset();  // a later callback would write to freed memory, which the sanitizers detect
    EXPECT_TRUE(sessions[0].is_closed());
  }
}

TEST(Threads, SessionsMayBeUsedFromManyThreads) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  SessionOptions options = walking();
  options.clock = Clock::real_time;
  auto session = client->open(options);
  ASSERT_TRUE(session->wait_frame(0, kLimitS));
  std::vector<std::thread> threads;
  for (int number = 0; number < 4; ++number) {
    threads.emplace_back([&session, number] {
      std::vector<float> row(session->rig().row_width);
      for (int call = 0; call < 50; ++call) {
        static_cast<void>(session->sample(row));
        static_cast<void>(session->stats());
        if (call % 25 == number) static_cast<void>(session->set_velocity(0, 1, 1));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_FALSE(session->is_closed());
}

}  // namespace
}  // namespace motiongen
