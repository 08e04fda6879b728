// Waits for what will never come end at once, and say why, instead of lasting until their timeout.
#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kLimitS = 60;

// A client of a server that answers nothing but openings.
struct Waiting {
  ScriptedServer server;
  Result<Client> client = Status();

  explicit Waiting(bool opens = true) {
    server.hear = [opens](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
      if (opens && event.has_open()) stream.Write(ScriptedServer::opened(event));
    };
    client = Client::connect(server.options());
  }
};

TEST(Waiting, EditThatWasNotMadeOrWhoseAnswerIsNoLongerKeptIsRefused) {
  Waiting stage;
  ASSERT_TRUE(stage.client) << stage.client.status().message();
  auto session = stage.client->open({});
  ASSERT_TRUE(session && session->wait_open(kLimitS));
  for (const EditId edit : {EditId{0}, EditId{1}, EditId{77}}) {
    EXPECT_EQ(session->wait_edit(edit, HUGE_VAL).status().code(), Code::invalid_argument) << edit;
  }
  const auto made = session->set_velocity(0, 1, 1);
  ASSERT_TRUE(made);
  EXPECT_EQ(session->wait_edit(made.value(), 0.01).status().code(), Code::deadline_exceeded) << "it is unanswered";
}

TEST(Waiting, TargetThatWasNotSetIsRefused) {
  Waiting stage;
  ASSERT_TRUE(stage.client) << stage.client.status().message();
  auto session = stage.client->open({});
  ASSERT_TRUE(session && session->wait_open(kLimitS));
  for (const std::uint32_t target : {0U, 1U, 77U}) {
    EXPECT_EQ(session->wait_reached(target, HUGE_VAL).status().code(), Code::invalid_argument) << target;
  }
  std::uint32_t id = 0;
  ASSERT_TRUE(session->go_to(1, 2, {}, false, &id));
  EXPECT_EQ(session->wait_reached(id, 0.01).status().code(), Code::deadline_exceeded) << "it is not reached yet";
}

TEST(Waiting, FrameAndOpeningOfASessionClosedHereAreNotWaitedFor) {
  for (const bool opens : {true, false}) {
    Waiting stage(opens);
    ASSERT_TRUE(stage.client) << stage.client.status().message();
    auto session = stage.client->open({});
    ASSERT_TRUE(session);
    if (opens) {
      ASSERT_TRUE(session->wait_open(kLimitS));
    }
    std::thread waiting([&session, opens] {
      const Status told = opens ? session->wait_frame(0, HUGE_VAL) : session->wait_open(HUGE_VAL).status();
      EXPECT_EQ(told.reason(), "CLIENT") << told.message();
    });
    ASSERT_TRUE(session->close());  // which the server does not answer
    waiting.join();
  }
}

}  // namespace
}  // namespace motiongen
