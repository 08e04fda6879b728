// A server that does not read its stream, whatever it sends.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "client/core.hpp"
#include "scripted_server.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr double kPingPeriodS = 0.4;
constexpr auto kLimit = std::chrono::seconds(60);

TEST(Unread, ConnectionWithoutPongsIsGivenUpWhateverElseIsSent) {
  ScriptedServer server;
  server.answers_pings = false;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    v1::StreamMotionResponse said;  // sent for each report too; reports come more often than pings
    if (event.has_open()) {
      said.add_updates()->set_session(event.session());
      said.mutable_updates(0)->mutable_opened()->set_rig_id("r");
      said.mutable_updates(0)->mutable_opened()->set_model_id("m");
    }
    stream.Write(said);
  };
  std::promise<std::string> lost;
  std::atomic<bool> is_told{false};
  ClientOptions options = server.options();
  options.ping_period_s = kPingPeriodS;
  options.reconnect = false;
  options.on_event = [&](const Event& event) {
    if (event.kind == EventKind::connection_lost && !is_told.exchange(true)) {
      lost.set_value(event.outcome.status.reason());
    }
  };
  auto client = Client::connect(options);
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session);
  auto reason = lost.get_future();
  ASSERT_EQ(reason.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(reason.get(), "SERVER_SILENT");
}

std::string taken(Outbox& outbox) {
  std::string message;
  return outbox.take(message) ? message : "none";
}

v1::StreamMotionRequest ping(std::int64_t time_ns) {
  v1::StreamMotionRequest request;
  request.mutable_ping()->set_client_time_ns(time_ns);
  return request;
}

TEST(Unread, NewestPingOvertakesWaitingEvents) {
  Outbox outbox;
  outbox.put("events");
  outbox.put_ping(ping(1));
  outbox.put_ping(ping(2));
  outbox.put("more");
  EXPECT_EQ(taken(outbox), ping(2).SerializeAsString());
  EXPECT_EQ(taken(outbox), "eventsmore");
  outbox.put_ping(ping(3));
  outbox.clear();
  EXPECT_EQ(taken(outbox), "none");
}

void fill(Outbox& outbox) {
  const std::string big(Outbox::kMostWaiting / 8, 'x');
  outbox.set_limit(1 << 20);                              // each is a message of its own
  for (int part = 0; part < 10; ++part) outbox.put(big);  // one of them may be being sent
}

TEST(Unread, OutboxIsFullUntilItIsRead) {
  Outbox outbox;
  EXPECT_FALSE(outbox.is_full());
  fill(outbox);
  outbox.put_alone(ping(1));
  EXPECT_TRUE(outbox.is_full());
  static_cast<void>(taken(outbox));
  EXPECT_TRUE(outbox.is_full());
  while (taken(outbox) != "none") continue;
  EXPECT_FALSE(outbox.is_full());
  fill(outbox);
  outbox.clear();
  EXPECT_FALSE(outbox.is_full());
}

TEST(Unread, ReportsAreLeftOutWhileTheServerDoesNotRead) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  static_cast<void>(stage.sent());
  fill(stage.outbox);
  stage.state.report(1, 0.25, stage.outbox);
  std::string message;
  while (stage.outbox.take(message)) EXPECT_EQ(message.find_first_not_of('x'), std::string::npos);
  stage.state.report(2, 0.25, stage.outbox);
  EXPECT_EQ(stage.sent(v1::SessionEvent::kPlayhead).size(), 1U);
}

// A server that opens sessions, and reads nothing after the first event until it is released.
struct Unreading {
  ScriptedServer server;
  std::promise<void> release;
  std::shared_ptr<ClientCore> core;
  std::shared_ptr<SessionState> session;

  Unreading() {
    server.hear = [released = release.get_future().share()](const v1::SessionEvent& event,
                                                            ScriptedServer::Stream& stream) {
      if (event.has_open()) stream.Write(ScriptedServer::opened(event));
      released.wait();
    };
    core = std::make_shared<ClientCore>(server.options());
  }
  Unreading(const Unreading&) = delete;
  Unreading& operator=(const Unreading&) = delete;
  ~Unreading() {
    release.set_value();
    core->shut_down();
  }

  // Returns whether a session plays.
  bool connect() {
    if (!core->connect()) return false;
    auto opened = core->open({});
    if (!opened) return false;
    session = std::move(opened).value();
    std::unique_lock<std::mutex> lock(session->mutex);
    return session->changed.wait_for(lock, kLimit, [this] { return session->timeline.has_value(); });
  }
};

TEST(Unread, EditsAndOpensAreRefusedWhileTheServerDoesNotRead) {
  Unreading stage;
  ASSERT_TRUE(stage.connect());
  fill(stage.core->outbox());
  v1::SessionEvent told;
  told.mutable_set_velocity()->set_x(1);
  const auto refused = stage.core->edit(*stage.session, told);
  EXPECT_EQ(refused.status().code(), Code::resource_exhausted);
  EXPECT_EQ(refused.status().reason(), "OUTBOX_FULL");
  {
    const std::lock_guard<std::mutex> lock(stage.session->mutex);
    EXPECT_FALSE(stage.session->book.is_waiting()) << "a refused edit must not be sent later";
  }
  EXPECT_EQ(stage.core->open({}).status().reason(), "OUTBOX_FULL");
  stage.core->outbox().clear();
  EXPECT_TRUE(stage.core->edit(*stage.session, told));
}

TEST(Unread, RefusedPauseDoesNotStopPlayback) {
  Unreading stage;
  ASSERT_TRUE(stage.connect());
  const auto is_playing = [&stage] {
    const std::lock_guard<std::mutex> lock(stage.session->mutex);
    return stage.session->timeline->playing();
  };
  v1::SessionEvent pause;
  pause.mutable_set_play_state()->set_state(v1::PLAY_STATE_PAUSED);
  fill(stage.core->outbox());
  EXPECT_FALSE(stage.core->edit(*stage.session, pause));
  EXPECT_TRUE(is_playing()) << "the server plays on: the pause was not sent";
  stage.core->outbox().clear();
  EXPECT_TRUE(stage.core->edit(*stage.session, pause));
  EXPECT_FALSE(is_playing());
}

}  // namespace
}  // namespace motiongen
