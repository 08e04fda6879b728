#include "session_stage.hpp"

namespace motiongen {
namespace {

TEST(SessionState, EndsWhereItsOpenIsRefusedAfterItWasClosed) {
  for (const Code code : {Code::resource_exhausted, Code::unavailable, Code::not_found}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.state.send_close(stage.outbox);
    ASSERT_EQ(stage.state.phase, Phase::closing);
    stage.hear_refused(code);
    EXPECT_EQ(stage.state.phase, Phase::closed);
    EXPECT_EQ(stage.state.ended.reason(), "CLIENT");
    EXPECT_FALSE(stage.state.refusal) << "no other server is to be asked";
    EXPECT_EQ(stage.num_closed(), 0) << "it ended as its user wished";
  }
}

TEST(SessionState, EndsWhereItsResumeIsRefusedAfterItWasClosed) {
  for (const Code code : {Code::not_found, Code::unavailable}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.hear_opened();
    ASSERT_EQ(stage.state.phase, Phase::open) << stage.state.ended.message();
    stage.state.lose(Status(Code::unavailable, "", "cut"), true, stage.events);
    stage.open();
    stage.state.send_close(stage.outbox);
    stage.hear_refused(code);
    EXPECT_EQ(stage.state.phase, Phase::closed);
    EXPECT_EQ(stage.num_closed(), 0);
  }
}

TEST(SessionState, ThatIsRefusedBeforeItIsClosedAsksAnotherServer) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_refused(Code::resource_exhausted);
  EXPECT_EQ(stage.state.phase, Phase::waiting);
  ASSERT_TRUE(stage.state.refusal);
  EXPECT_EQ(stage.state.refusal->other_servers.size(), 1U);
}

TEST(SessionState, ThatWasAskedForAgainMeanwhileIsNotGivenUp) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_refused(Code::resource_exhausted);
  stage.open();  // its time has come
  stage.state.give_up_opening(stage.events);
  EXPECT_EQ(stage.state.phase, Phase::opening);
  EXPECT_EQ(stage.num_closed(), 0);
}

v1::OpenSession with_prompt(std::size_t bytes) {
  v1::OpenSession open;
  open.add_prompts()->set_text(std::string(bytes, 'x'));
  return open;
}

TEST(SessionState, ThatIsTooBigForAMessageEndsAlone) {
  Stage fits(with_prompt(3000));
  const std::lock_guard<std::mutex> lock(fits.state.mutex);
  fits.open();
  EXPECT_EQ(fits.sent(v1::SessionEvent::kOpen).size(), 1U);
  Stage stage(with_prompt(4000));
  const std::lock_guard<std::mutex> other(stage.state.mutex);
  stage.open();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.code(), Code::invalid_argument);
  EXPECT_EQ(stage.num_closed(), 1) << "it is told";
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kOpen).empty()) << "the server would end the stream";
}

TEST(SessionState, ThatHasGrownTooBigToBeOpenedAnewEndsAlone) {
  Stage stage(with_prompt(3000));
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  ASSERT_EQ(stage.state.phase, Phase::open);
  stage.lose();
  stage.known.limits.max_request_bytes = 2048;  // of another server
  static_cast<void>(stage.sent(v1::SessionEvent::kOpen));
  stage.open();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.num_closed(), 1);
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kOpen).empty());
}

TEST(SessionState, ThatEndsAtItsOpeningIsClosedAtTheServerToo) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("t", "unheard-of");
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.num_closed(), 1);
  EXPECT_EQ(stage.sent(v1::SessionEvent::kClose).size(), 1U);
}

TEST(SessionState, PausedBeforeItOpensStandsStillFromTheFirst) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.state.set_playing(false);
  stage.hear_opened();
  ASSERT_TRUE(stage.state.timeline);
  EXPECT_FALSE(stage.state.timeline->playing());
  stage.state.set_playing(true);
  EXPECT_TRUE(stage.state.timeline->playing());
}

TEST(SessionState, PausedBeforeItsFirstFrameSaysWhereItStands) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.state.set_playing(false);
  stage.hear_opened();
  stage.hold(20);
  stage.state.report(1, 0.25, stage.outbox);
  const auto reports = stage.sent(v1::SessionEvent::kPlayhead);
  ASSERT_EQ(reports.size(), 1U) << "or it is closed for its silence";
  EXPECT_EQ(reports[0].playhead().frame(), 0U);
  EXPECT_EQ(reports[0].playhead().buffered_to(), 20U);
}

TEST(SessionState, OpenedAnewItIsSilentUntilItComesThereUnlessItStands) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(20);
  ASSERT_TRUE(stage.state.timeline->advance_to(5));
  stage.lose();
  stage.open();
  stage.hear_opened("");
  static_cast<void>(stage.sent(v1::SessionEvent::kOpen));
  stage.state.report(1, 0.25, stage.outbox);
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kPlayhead).empty()) << "the server would count on from there";
  stage.state.set_playing(false);
  stage.state.report(2, 0.25, stage.outbox);
  const auto reports = stage.sent(v1::SessionEvent::kPlayhead);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_EQ(reports[0].playhead().frame(), 0U);
  EXPECT_EQ(reports[0].playhead().buffered_to(), 0U);
  stage.state.set_playing(true);
  stage.state.report(3, 0.25, stage.outbox);
  EXPECT_EQ(stage.sent(v1::SessionEvent::kPlayhead).size(), 1U) << "the server counts on from what it was told";
}

TEST(SessionState, OpenedAnewItIsServedInFullUntilItIsTold) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  v1::SessionUpdate less;
  less.mutable_service_level()->set_tier(v1::SERVICE_TIER_FEWER_STEPS);
  less.mutable_service_level()->set_denoise_steps(2);
  stage.hear(less);
  const auto levels = [&stage] {
    std::vector<std::uint32_t> tiers;
    for (Event event; stage.events.take(event);) {
      if (event.kind == EventKind::service_level) tiers.push_back(event.level.tier);
    }
    return tiers;
  };
  EXPECT_EQ(levels(), (std::vector<std::uint32_t>{2}));
  for (const std::size_t expected : {1U, 0U}) {
    stage.lose();
    stage.open();
    stage.hear_opened("");
    EXPECT_EQ(levels().size(), expected) << "told where it differs";
  }
}

}  // namespace
}  // namespace motiongen
