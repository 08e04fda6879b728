// Results of targets: a wait ends with the result, or with the reason why there will be none.
#include "client/reached.hpp"

#include "client/convert.hpp"
#include "scripted_server.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint32_t kTarget = 1;

// An open session whose targets are set.
struct Walking : Stage {
  explicit Walking(const char* token = "t") {
    open();
    hear_opened(token);
    static_cast<void>(sent());
  }

  // Set or replace a target. Returns the number of the event.
  std::uint64_t set(std::uint32_t target, std::uint64_t frame) {
    v1::SessionEvent event;
    auto* constraint = event.mutable_edit_constraints()->add_upsert();
    constraint->set_constraint_id(target);
    constraint->set_frame(frame);
    constraint->mutable_waypoint();
    state.reached_book.forget(target);
    state.send_edit(std::move(event), outbox, events);
    return sent().back().event_seq();
  }

  // placed_at: the last frame of the placement; 0: the answer has no placement.
  void hear_answer(std::uint64_t seq, Code code = Code::ok, std::uint64_t placed_at = 0) {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_event_seq(seq);
    update.mutable_outcome()->set_code(static_cast<int>(code));
    if (code != Code::ok) update.mutable_outcome()->set_reason("FRAME_COMMITTED");
    if (placed_at != 0) {
      update.mutable_outcome()->add_placements()->set_constraint_id(kTarget);
      update.mutable_outcome()->mutable_placements(0)->set_last_frame(placed_at);
    }
    hear(update);
  }

  // The last frame of the placement that is known; 0: none is.
  std::uint64_t placed_at() const {
    return state.reached_book.find_placement(kTarget).value_or(Placement()).last_frame;
  }

  void hear_reached(std::uint64_t frame) {
    v1::SessionUpdate update;
    update.mutable_constraint_reached()->set_constraint_id(kTarget);
    update.mutable_constraint_reached()->set_frame(frame);
    hear(update);
  }

  std::string refusal(std::uint32_t target = kTarget) const {
    return state.reached_book.find_refusal(target).value_or(Status()).reason();
  }
};

TEST(Reached, RefusedTargetHasARefusalUntilItIsReplaced) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10), Code::failed_precondition);
  EXPECT_EQ(stage.refusal(), "FRAME_COMMITTED");
  stage.hear_answer(stage.set(kTarget, 100));
  EXPECT_EQ(stage.refusal(), "") << "the replacement has no refusal";
}

TEST(Reached, ResultStaysKnownWhenAReplacementIsRefused) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10));
  stage.hear_reached(10);
  const std::uint64_t seq = stage.set(kTarget, 12);
  EXPECT_FALSE(stage.state.reached_book.find(kTarget)) << "the next result may be of the replacement";
  stage.hear_answer(seq, Code::failed_precondition);
  ASSERT_TRUE(stage.state.reached_book.find(kTarget));
  EXPECT_EQ(stage.state.reached_book.find(kTarget)->frame, 10U);
  EXPECT_EQ(stage.refusal(), "");
}

TEST(Reached, TargetAheadIsStillExpectedWhenAReplacementIsRefused) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 100));
  stage.hear_answer(stage.set(kTarget, 12), Code::failed_precondition);
  EXPECT_EQ(stage.refusal(), "") << "the target before is still ahead";
}

TEST(Reached, OnlyTheLastAcceptedOfTwoReplacementsCounts) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10));
  stage.hear_reached(10);
  const std::uint64_t first = stage.set(kTarget, 12);
  const std::uint64_t second = stage.set(kTarget, 100);
  stage.hear_answer(first, Code::failed_precondition);
  EXPECT_FALSE(stage.state.reached_book.find(kTarget));
  EXPECT_EQ(stage.refusal(), "") << "the second is unanswered";
  stage.hear_answer(second);
  EXPECT_FALSE(stage.state.reached_book.find(kTarget));
}

TEST(Reached, RepeatedResultIsNotTakenForThatOfTheReplacement) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10));
  stage.hear_reached(10);
  stage.hear_answer(stage.set(kTarget, 60));
  stage.hear_reached(10);  // repeated, as to a session that resumes
  EXPECT_FALSE(stage.state.reached_book.find(kTarget));
  stage.hear_reached(60);
  ASSERT_TRUE(stage.state.reached_book.find(kTarget));
  EXPECT_EQ(stage.state.reached_book.find(kTarget)->frame, 60U);
}

TEST(Reached, ResultThatCrossesAReplacementBelongsToTheReplacedTarget) {
  for (const Code code : {Code::ok, Code::failed_precondition}) {
    Walking stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.hear_answer(stage.set(kTarget, 10));
    const std::uint64_t seq = stage.set(kTarget, 60);
    stage.hear_reached(10);
    stage.hear_answer(seq, code);
    EXPECT_EQ(stage.state.reached_book.find(kTarget).has_value(), code != Code::ok);
  }
}

TEST(Reached, ResultOfAReplacedReplacementIsNotOfTheLastTarget) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10));
  const std::uint64_t first = stage.set(kTarget, 12);
  const std::uint64_t second = stage.set(kTarget, 100);
  stage.hear_answer(first);
  stage.hear_reached(12);
  stage.hear_answer(second);
  EXPECT_FALSE(stage.state.reached_book.find(kTarget));
}

TEST(Reached, PlacementOfAReplacedReplacementIsNotOfTheLastTarget) {
  for (const Code code : {Code::ok, Code::failed_precondition}) {
    Walking stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.hear_answer(stage.set(kTarget, 10), Code::ok, 30);
    EXPECT_EQ(stage.placed_at(), 30U);
    const std::uint64_t first = stage.set(kTarget, 12);
    const std::uint64_t second = stage.set(kTarget, 100);
    EXPECT_EQ(stage.placed_at(), 0U);
    stage.hear_answer(first, Code::ok, 40);
    EXPECT_EQ(stage.placed_at(), 0U) << "the second is unanswered";
    stage.hear_answer(second, code);  // its frame was given, so it has no placement
    EXPECT_EQ(stage.placed_at(), code == Code::ok ? 0U : 40U);
  }
}

TEST(Reached, PlacementInARepeatedAnswerIsNotOfThePresentTarget) {
  Walking stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  const std::uint64_t first = stage.set(kTarget, 10);
  stage.hear_answer(first, Code::ok, 30);
  stage.hear_answer(stage.set(kTarget, 100));
  stage.hear_answer(first, Code::ok, 30);  // repeated, as to a session that resumes
  EXPECT_EQ(stage.placed_at(), 0U);
}

TEST(Reached, TargetThatPassedWhileDisconnectedIsRefusedAtReopening) {
  Walking stage("");
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(stage.set(kTarget, 10));
  stage.hear_answer(stage.set(2, 100));
  stage.hold(20);
  stage.lose();
  stage.open();
  stage.hear_opened("");
  ASSERT_EQ(stage.state.phase, Phase::open);
  EXPECT_EQ(stage.refusal(kTarget), "FRAME_COMMITTED");
  EXPECT_EQ(stage.refusal(2), "") << "it was sent to the new session";
}

TEST(Reached, UnansweredEditThatPassedIsRefusedByTheClientAndNotSent) {
  Walking stage("");
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hold(20);
  stage.set(kTarget, 10);
  stage.set(2, 100);
  stage.set(3, 12);
  stage.lose();
  stage.open();
  stage.hear_opened("");
  const auto said = stage.sent(v1::SessionEvent::kEditConstraints);
  ASSERT_EQ(said.size(), 1U) << "the server would have the passed ones met at its frame 0";
  EXPECT_EQ(said[0].event_seq(), 2U);
  EXPECT_EQ(said[0].edit_constraints().upsert(0).constraint_id(), 2U);
  EXPECT_EQ(stage.refusal(kTarget), "FRAME_COMMITTED");
  EXPECT_EQ(stage.refusal(2), "");
  EXPECT_EQ(stage.refusal(3), "FRAME_COMMITTED");
  ASSERT_TRUE(stage.state.find_answer(1));
  EXPECT_EQ(stage.state.find_answer(1)->status.reason(), "FRAME_COMMITTED");
  EXPECT_EQ(stage.state.find_answer(1)->status.message(), "its frames passed while the connection was lost");
  EXPECT_FALSE(stage.state.find_answer(2));
  v1::SessionEvent late;
  *late.mutable_edit_prompts()->add_upsert() = convert::span(2, Prompt("wave"), 5, 15);
  const EditId edit = stage.state.send_edit(std::move(late), stage.outbox, stage.events);
  EXPECT_TRUE(stage.sent().empty());
  ASSERT_TRUE(stage.state.find_answer(edit));
  EXPECT_EQ(stage.state.find_answer(edit)->status.reason(), "FRAME_COMMITTED");
}

// Targets 1 and 2; the first is at a frame that is held when the connection is lost.
v1::SessionEvent two_targets() {
  v1::SessionEvent event;
  for (const std::uint32_t id : {1U, 2U}) {
    *event.mutable_edit_constraints()->add_upsert() =
        convert::constraint(id, Waypoint{id == 1 ? 10U : 100U, 1, 2, {}, {}});
  }
  return event;
}

TEST(Reached, EditThatPassedInPartIsSentWithoutThePassedTargets) {
  for (const bool is_told_before : {true, false}) {
    Walking stage("");
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.hold(20);
    if (is_told_before) stage.state.send_edit(two_targets(), stage.outbox, stage.events);
    static_cast<void>(stage.sent());
    stage.lose();
    stage.open();
    stage.hear_opened("");
    if (!is_told_before) stage.state.send_edit(two_targets(), stage.outbox, stage.events);
    const auto said = stage.sent(v1::SessionEvent::kEditConstraints);
    ASSERT_EQ(said.size(), 1U);
    ASSERT_EQ(said[0].edit_constraints().upsert_size(), 1);
    EXPECT_EQ(said[0].edit_constraints().upsert(0).frame(), 80U);
    stage.hear_answer(said[0].event_seq());
    EXPECT_EQ(stage.refusal(1), "FRAME_COMMITTED");
    EXPECT_EQ(stage.refusal(2), "");
  }
}

TEST(Reached, PassedPromptIsRefusedAlthoughItsEditAlsoRemovesOne) {
  Walking stage("");
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hold(20);
  stage.lose();
  stage.open();
  stage.hear_opened("");
  static_cast<void>(stage.sent());
  v1::SessionEvent late;
  late.mutable_edit_prompts()->add_remove(2);
  *late.mutable_edit_prompts()->add_upsert() = convert::span(3, Prompt("wave"), 5, 15);
  const EditId edit = stage.state.send_edit(std::move(late), stage.outbox, stage.events);
  EXPECT_TRUE(stage.sent().empty()) << "the server would accept it";
  ASSERT_TRUE(stage.state.find_answer(edit));
  EXPECT_EQ(stage.state.find_answer(edit)->status.reason(), "FRAME_COMMITTED");
}

TEST(Reached, RefusalStaysKnownWhenAReplacementIsNotAccepted) {
  ReachedBook book;
  book.refuse(kTarget, Status(Code::failed_precondition, "FRAME_COMMITTED", "too late"));
  book.forget(kTarget);
  book.settle(kTarget, false, true);
  EXPECT_TRUE(book.find_refusal(kTarget)) << "else its waits would never end";
}

TEST(Reached, WaitEndsWithTheRefusal) {
  ScriptedServer server;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (!event.has_open() && !event.has_edit_constraints()) return;
    v1::StreamMotionResponse said;
    auto* update = said.add_updates();
    update->set_session(event.session());
    if (event.has_open()) {
      update->mutable_opened()->set_rig_id("r");
      update->mutable_opened()->set_model_id("m");
    } else {
      update->mutable_outcome()->set_event_seq(event.event_seq());
      update->mutable_outcome()->set_code(static_cast<int>(Code::failed_precondition));
      update->mutable_outcome()->set_reason("FRAME_COMMITTED");
    }
    stream.Write(said);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session && session->wait_open(60));
  const Target there = Waypoint{1, 0, 0, {}, {}};
  std::vector<std::uint32_t> ids;
  ASSERT_TRUE(session->add_targets({&there, 1}, &ids));
  EXPECT_EQ(session->wait_reached(ids[0], 60).status().reason(), "FRAME_COMMITTED");
}

}  // namespace
}  // namespace motiongen
