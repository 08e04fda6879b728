#include "client/convert.hpp"
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

TEST(SessionState, ThatIsClosedHereSaysSoAtOnceAndIfTheLineIsLostMeanwhile) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  stage.state.send_close(stage.outbox);
  EXPECT_EQ(stage.state.ended.reason(), "CLIENT") << "edits that are refused from now on name it";
  stage.lose();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.reason(), "CLIENT");
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
  stage.known.limits.max_request_bytes = 2048;  // as another server has it
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

TEST(SessionState, ClosedWhileItIsResumedSaysSoBehindWhatWasNotAnswered) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  stage.lose();
  v1::SessionEvent told;
  told.mutable_set_velocity()->set_x(1);
  stage.state.send_edit(std::move(told), stage.outbox, stage.events);
  static_cast<void>(stage.sent());
  stage.open();
  stage.state.send_close(stage.outbox);
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kClose).empty())
      << "a gap: the server would refuse it, and the session stay";
  stage.hear_opened();
  const auto said = stage.sent();
  ASSERT_EQ(said.size(), 2U);
  EXPECT_EQ(said[0].event_case(), v1::SessionEvent::kSetVelocity);
  EXPECT_EQ(said[0].event_seq(), 2U);
  EXPECT_EQ(said[1].event_case(), v1::SessionEvent::kClose);
  EXPECT_EQ(said[1].event_seq(), 3U);
  EXPECT_EQ(stage.state.phase, Phase::closing);
  v1::SessionUpdate closed;
  closed.mutable_closed()->set_reason(v1::CLOSE_REASON_CLIENT);
  stage.hear(closed);
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.num_closed(), 0) << "it ended as its user wished";
}

TEST(SessionState, OpenedAnewItHasTheHistoryThatWasAskedForLast) {
  Stage stage;
  stage.known.models[0].patch_frames = 4;
  stage.known.models[0].default_history_frames = 8;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(40);
  v1::SessionEvent event;
  event.mutable_set_options()->set_history_frames(16);
  stage.state.send_edit(std::move(event), stage.outbox, stage.events);
  v1::SessionUpdate update;
  update.mutable_outcome()->set_event_seq(2);
  stage.hear(update);
  stage.lose();
  static_cast<void>(stage.sent());
  stage.open();
  const auto said = stage.sent(v1::SessionEvent::kOpen);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_EQ(said[0].open().prior_frames().frame_count(), 16U);
}

TEST(SessionState, OpenedAnewItIsNotAskedForATargetThatWasMetEarly) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(40);
  v1::SessionEvent event;
  for (const std::uint32_t id : {1U, 2U}) {
    auto* constraint = event.mutable_edit_constraints()->add_upsert();
    *constraint = convert::constraint(id, Waypoint{20, 1, 2, {}, {}});
    constraint->set_last_frame(200);  // at any frame up to there
  }
  stage.state.send_edit(std::move(event), stage.outbox, stage.events);
  v1::SessionUpdate taken;
  taken.mutable_outcome()->set_event_seq(2);
  stage.hear(taken);
  v1::SessionUpdate met;
  met.mutable_constraint_reached()->set_constraint_id(1);
  met.mutable_constraint_reached()->set_met(true);
  met.mutable_constraint_reached()->set_frame(30);
  stage.hear(met);
  stage.lose();
  static_cast<void>(stage.sent());
  stage.open();
  const auto said = stage.sent(v1::SessionEvent::kOpen);
  ASSERT_EQ(said.size(), 1U);
  ASSERT_EQ(said[0].open().constraints_size(), 1) << "it would walk back";
  EXPECT_EQ(said[0].open().constraints(0).constraint_id(), 2U);
}

TEST(SessionState, KeepsAsManyFramesAsATimelineCan) {
  SessionOptions options;
  for (const std::uint32_t fits : {0U, TimelineOptions::kMostKept, TimelineOptions::kKeepAll}) {
    options.keep_frames = fits;
    EXPECT_TRUE(convert::check(options)) << fits;
  }
  options.keep_frames = TimelineOptions::kMostKept + 1;
  const Status refused = convert::check(options);
  EXPECT_EQ(refused.code(), Code::invalid_argument) << "or it would end once it has opened";
  EXPECT_NE(refused.message().find("keep_frames"), std::string::npos);
}

}  // namespace
}  // namespace motiongen
