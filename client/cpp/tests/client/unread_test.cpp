// A server that does not read what it is told, whatever else it says.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <string>

#include "client/outbox.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kPingPeriodS = 0.4;
constexpr auto kLimit = std::chrono::seconds(60);

TEST(Unread, AServerThatSpeaksAndAnswersNoPingIsGivenUp) {
  ScriptedServer server;
  server.answers_pings = false;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    v1::StreamMotionResponse said;  // to each report, which come more often than pings
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

TEST(Unread, APingOvertakesWhatWaitsAndTheNewestCounts) {
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

}  // namespace
}  // namespace motiongen
