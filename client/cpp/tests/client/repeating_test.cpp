// Unanswered events are sent again within the server's rate limit, and new events after them.
#include "client/repeating.hpp"

#include <chrono>
#include <condition_variable>
#include <limits>
#include <memory>
#include <mutex>
#include <numeric>
#include <utility>
#include <vector>

#include "client/convert.hpp"
#include "client/core.hpp"
#include "scripted_server.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

using Numbers = std::vector<std::uint64_t>;

v1::SessionEvent prompt() {
  v1::SessionEvent event;
  *event.mutable_edit_prompts()->add_upsert() = convert::span(2, Prompt("wave"), 0, 0);
  return event;
}

v1::SessionEvent velocity(float x_mps) {
  v1::SessionEvent event;
  event.mutable_set_velocity()->set_x(x_mps);
  return event;
}

Numbers from_to(std::uint64_t first, std::uint64_t last) {
  Numbers numbers(last - first + 1);
  std::iota(numbers.begin(), numbers.end(), first);
  return numbers;
}

// An open session at a server with this rate limit, in events per second.
struct Talking : Stage {
  explicit Talking(float per_second, const char* token = "t", SessionOptions options = {})
      : Stage({}, std::move(options)), token_(token) {
    known.limits.max_events_per_second = per_second;
    open();
    hear_opened(token_);
    static_cast<void>(sent());
  }

  EditId edit(v1::SessionEvent event) { return state.send_edit(std::move(event), outbox, events); }

  void edit_while_disconnected(int count) {
    lose();
    for (int time = 0; time < count; ++time) edit(prompt());
  }

  // The session is resumed, or reopened if it has no token.
  void reconnect() {
    open();
    hear_opened(token_);
  }

  // The numbers of the edits, and of the close, that were sent since the last call.
  Numbers numbers() {
    Numbers found;
    for (const v1::SessionEvent& each : sent()) {
      if (!each.has_open() && !each.has_playhead()) found.push_back(each.event_seq());
    }
    return found;
  }

  Numbers numbers_at(double now_s) {
    state.say_more(now_s, outbox);
    return numbers();
  }

  void hear_answer(std::uint64_t seq, std::uint64_t effective_frame = 0) {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_event_seq(seq);
    update.mutable_outcome()->set_effective_frame(effective_frame);
    hear(update);
  }

 private:
  const char* token_;
};

TEST(Repeating, HalfASecondOfTheRateIsResentAtOnceAndTheRestPaced) {
  for (const char* token : {"t", ""}) {
    Talking stage(24, token);
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.edit_while_disconnected(20);
    stage.reconnect();
    EXPECT_EQ(stage.numbers(), from_to(2, 13));
    stage.edit(prompt());
    EXPECT_TRUE(stage.numbers().empty()) << "new edits wait behind the repeated ones";
    EXPECT_TRUE(stage.numbers_at(10).empty());
    EXPECT_TRUE(stage.numbers_at(10.125).empty());
    std::uint64_t said_to = 13;
    for (double now_s = 10.25; said_to < 21; now_s += Repeating::kPeriodS, said_to += 2) {
      EXPECT_EQ(stage.numbers_at(now_s), from_to(said_to + 1, said_to + 2));
      EXPECT_TRUE(stage.numbers_at(now_s).empty());
    }
    EXPECT_EQ(stage.numbers_at(20), Numbers{22});
    stage.edit(prompt());
    EXPECT_EQ(stage.numbers(), Numbers{23}) << "sent at once";
  }
}

TEST(Repeating, AllEventsAreResentAtOnceToAServerWithoutARateLimit) {
  Talking stage(0);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.edit_while_disconnected(20);
  stage.reconnect();
  EXPECT_EQ(stage.numbers(), from_to(2, 21));
}

TEST(Repeating, InterruptedResendingStartsAgainWithUnansweredEvents) {
  Talking stage(6);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.edit_while_disconnected(6);
  stage.reconnect();
  EXPECT_EQ(stage.numbers(), from_to(2, 4));
  stage.hear_answer(2);
  stage.lose();
  for (const double now_s : {10.0, 20.0, 30.0})
    EXPECT_TRUE(stage.numbers_at(now_s).empty()) << "nothing is sent without a connection";
  stage.open();
  EXPECT_TRUE(stage.numbers_at(40).empty()) << "the server has not confirmed the session yet";
  stage.hear_opened();
  EXPECT_EQ(stage.numbers(), from_to(3, 5));
}

TEST(Repeating, ClosingSendsTheRestAndThenTheClose) {
  Talking stage(6);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.edit_while_disconnected(6);
  stage.reconnect();
  stage.state.send_close(stage.outbox);
  EXPECT_EQ(stage.numbers(), from_to(2, 8)) << "a server refuses a close out of order";
  EXPECT_TRUE(stage.numbers_at(10).empty());
}

TEST(Repeating, OnlyTheNewestOfUnsentVelocitiesIsSent) {
  Talking stage(60);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.edit(velocity(0.5F));
  stage.lose();
  Numbers edits;
  for (const float x_mps : {1.0F, 1.5F, 2.0F}) edits.push_back(stage.edit(velocity(x_mps)));
  stage.edit(prompt());
  const EditId last = stage.edit(velocity(2.5F));
  static_cast<void>(stage.sent());
  stage.reconnect();
  std::vector<float> said;
  for (const v1::SessionEvent& each : stage.sent()) {
    if (!each.has_open()) said.push_back(each.set_velocity().x());
  }
  EXPECT_EQ(said, (std::vector<float>{0.5F, 2, 0, 2.5F})) << "the first was sent before, so it is repeated unchanged";
  for (Event event; stage.events.take(event);) continue;
  stage.hear_answer(3, 10);
  Numbers answered;
  for (Event event; stage.events.take(event);) answered.push_back(event.edit);
  EXPECT_EQ(answered, edits);
  for (const EditId edit : edits) {
    ASSERT_TRUE(stage.state.find_answer(edit));
    EXPECT_EQ(stage.state.find_answer(edit)->effective_frame, std::optional<std::uint64_t>(10));
  }
  EXPECT_FALSE(stage.state.find_answer(last));
  stage.edit(velocity(3));
  EXPECT_EQ(stage.numbers(), Numbers{6}) << "the one before was sent";
}

TEST(Repeating, EditRefusedByTheClientDoesNotShareTheAnswerOfVelocities) {
  Talking stage(60, "");
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hold(20);
  stage.lose();
  stage.reconnect();
  stage.lose();
  stage.edit(velocity(1));
  v1::SessionEvent late;
  *late.mutable_edit_prompts()->add_upsert() = convert::span(2, Prompt("wave"), 5, 15);
  const EditId refused = stage.edit(std::move(late));
  stage.edit(velocity(2));
  static_cast<void>(stage.sent());
  stage.reconnect();
  EXPECT_EQ(stage.numbers(), from_to(2, 3));
  stage.hear_answer(2);
  stage.hear_answer(3);
  int num_answers = 0;
  for (Event event; stage.events.take(event);) num_answers += event.edit == refused ? 1 : 0;
  EXPECT_EQ(num_answers, 1);
}

TEST(Repeating, ManyMergedVelocitiesDoNotDisplaceAnswersOfOtherEdits) {
  Talking stage(60);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  const EditId before = stage.edit(prompt());
  stage.lose();
  const EditId first = stage.edit(velocity(1));
  for (int time = 0; time < 5000; ++time) stage.edit(velocity(2));
  stage.reconnect();
  stage.hear_answer(2);
  stage.hear_answer(3);
  for (const EditId edit : {before, first, first + 5000}) EXPECT_TRUE(stage.state.find_answer(edit)) << edit;
}

TEST(Repeating, ManualPlayheadIsReportedOnceWithEachPartThatIsSent) {
  SessionOptions options;
  options.clock = Clock::manual;
  Talking stage(6, "t", options);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.edit_while_disconnected(6);
  stage.reconnect();
  static_cast<void>(stage.sent());
  for (int time = 0; time < 20; ++time) stage.edit(prompt());
  EXPECT_TRUE(stage.sent().empty()) << "reports count towards the rate as edits do";
  static_cast<void>(stage.numbers_at(10));
  stage.state.say_more(11, stage.outbox);
  const auto said = stage.sent();
  ASSERT_EQ(said.size(), 2U);
  EXPECT_TRUE(said[0].has_playhead());
  EXPECT_EQ(said[1].event_seq(), 5U);
}

TEST(Repeating, ExtremeRateLimitsOfAServerAreHandled) {
  for (const double per_second : {1e-300, 1e300, std::numeric_limits<double>::infinity()}) {
    Repeating repeating;
    EXPECT_GE(repeating.begin(per_second), 1U);
    EXPECT_EQ(repeating.part_due(0), 0U);
    EXPECT_GE(repeating.part_due(std::numeric_limits<double>::max()), 1U);
  }
  Repeating repeating;
  EXPECT_EQ(repeating.begin(std::numeric_limits<double>::quiet_NaN()), Repeating::kAll);
}

TEST(Repeating, ClientSendsTheRestByItsClock) {
  ScriptedServer server;
  std::mutex mutex;
  std::condition_variable changed;
  Numbers heard;
  server.add_to_catalog = [](v1::GetCatalogResponse& told) { told.mutable_limits()->set_max_events_per_second(40); };
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
  {
    SessionState& state = *opened.value();
    std::unique_lock<std::mutex> lock(state.mutex);
    const auto is_open = [&state] { return state.phase == Phase::open; };
    ASSERT_TRUE(state.changed.wait_for(lock, std::chrono::seconds(60), is_open));
    state.lose(Status(Code::unavailable, "", "cut"), true, core->events());
    for (int time = 0; time < 25; ++time) state.send_edit(prompt(), core->outbox(), core->events());
  }
  {
    std::unique_lock<std::mutex> lock(mutex);
    EXPECT_TRUE(changed.wait_for(lock, std::chrono::seconds(60), [&] { return heard.size() >= 25; }));
    EXPECT_EQ(heard, from_to(2, 26));
  }
  core->shut_down();
}

}  // namespace
}  // namespace motiongen
