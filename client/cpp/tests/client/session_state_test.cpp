#include "client/convert.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

TEST(SessionState, ClosedSessionEndsWhenItsOpenIsRefused) {
  for (const Code code : {Code::resource_exhausted, Code::unavailable, Code::not_found}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.state.send_close(stage.outbox);
    ASSERT_EQ(stage.state.phase, Phase::closing);
    stage.hear_refused(code);
    EXPECT_EQ(stage.state.phase, Phase::closed);
    EXPECT_EQ(stage.state.ended.reason(), "CLIENT");
    EXPECT_FALSE(stage.state.refusal) << "no other server must be asked";
    EXPECT_EQ(stage.num_closed(), 0) << "the application closed it, and needs no event";
  }
}

TEST(SessionState, ClosedSessionEndsWhenItsResumeIsRefused) {
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

TEST(SessionState, ClosedSessionHasItsReasonAtOnceAndAfterALoss) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  stage.state.send_close(stage.outbox);
  EXPECT_EQ(stage.state.ended.reason(), "CLIENT") << "edits refused from now on name this reason";
  stage.lose();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.reason(), "CLIENT");
}

TEST(SessionState, RefusedOpenKeepsTheOtherServersToAsk) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_refused(Code::resource_exhausted);
  EXPECT_EQ(stage.state.phase, Phase::waiting);
  ASSERT_TRUE(stage.state.refusal);
  EXPECT_EQ(stage.state.refusal->other_servers.size(), 1U);
}

TEST(SessionState, OpenSentAgainMeanwhileIsNotGivenUp) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_refused(Code::resource_exhausted);
  stage.open();  // its retry is due
  stage.state.give_up_opening(stage.events);
  EXPECT_EQ(stage.state.phase, Phase::opening);
  EXPECT_EQ(stage.num_closed(), 0);
}

v1::OpenSession with_prompt(std::size_t bytes) {
  v1::OpenSession open;
  open.add_prompts()->set_text(std::string(bytes, 'x'));
  return open;
}

TEST(SessionState, OpenTooBigForAMessageEndsTheSessionAndIsNotSent) {
  Stage fits(with_prompt(3000));
  const std::lock_guard<std::mutex> lock(fits.state.mutex);
  fits.open();
  EXPECT_EQ(fits.sent(v1::SessionEvent::kOpen).size(), 1U);
  Stage stage(with_prompt(4000));
  const std::lock_guard<std::mutex> other(stage.state.mutex);
  stage.open();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.code(), Code::invalid_argument);
  EXPECT_EQ(stage.num_closed(), 1) << "the application gets a closed event";
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kOpen).empty()) << "the server would end the stream";
}

TEST(SessionState, ReopeningTooBigForAMessageEndsTheSessionAndIsNotSent) {
  Stage stage(with_prompt(3000));
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  ASSERT_EQ(stage.state.phase, Phase::open);
  stage.lose();
  stage.known.limits.max_request_bytes = 2048;  // the limit of another server
  static_cast<void>(stage.sent(v1::SessionEvent::kOpen));
  stage.open();
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.num_closed(), 1);
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kOpen).empty());
}

TEST(SessionState, SessionWithAnUnknownRigIsClosedAtTheServerToo) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("t", "unheard-of");
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.num_closed(), 1);
  EXPECT_EQ(stage.sent(v1::SessionEvent::kClose).size(), 1U);
}

TEST(SessionState, PauseBeforeTheOpeningHoldsFromTheFirstFrame) {
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

TEST(SessionState, SessionPausedBeforeItsFirstFrameReportsItsPlayhead) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.state.set_playing(false);
  stage.hear_opened();
  stage.hold(20);
  stage.state.report(1, 0.25, stage.outbox);
  const auto reports = stage.sent(v1::SessionEvent::kPlayhead);
  ASSERT_EQ(reports.size(), 1U) << "without a report the server closes it as idle";
  EXPECT_EQ(reports[0].playhead().frame(), 0U);
  EXPECT_EQ(reports[0].playhead().buffered_to(), 20U);
}

TEST(SessionState, ReopenedSessionReportsNoEarlierPlayheadUnlessPaused) {
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
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kPlayhead).empty()) << "the server would extrapolate from there";
  stage.state.set_playing(false);
  stage.state.report(2, 0.25, stage.outbox);
  const auto reports = stage.sent(v1::SessionEvent::kPlayhead);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_EQ(reports[0].playhead().frame(), 0U);
  EXPECT_EQ(reports[0].playhead().buffered_to(), 0U);
  stage.state.set_playing(true);
  stage.state.report(3, 0.25, stage.outbox);
  EXPECT_EQ(stage.sent(v1::SessionEvent::kPlayhead).size(), 1U) << "the server extrapolates from the reported playhead";
}

TEST(SessionState, ReopenedSessionHasFullServiceUntilTheServerReportsLess) {
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
    EXPECT_EQ(levels().size(), expected) << "reported only if it changes";
  }
}

TEST(SessionState, CloseWhileResumingIsSentAfterUnansweredEdits) {
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
      << "with a gap in the numbers, the server would refuse it and keep the session";
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
  EXPECT_EQ(stage.num_closed(), 0) << "the application closed it, and needs no event";
}

TEST(SessionState, ReopenedSessionSendsTheHistoryLengthLastRequested) {
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

TEST(SessionState, ReopenedSessionIsNotSentATargetThatWasMetEarly) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(40);
  v1::SessionEvent event;
  for (const std::uint32_t id : {1U, 2U}) {
    auto* constraint = event.mutable_edit_constraints()->add_upsert();
    *constraint = convert::constraint(id, Waypoint{20, 1, 2, {}, {}});
    constraint->set_last_frame(200);  // at any frame up to this one
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
  ASSERT_EQ(said[0].open().constraints_size(), 1) << "the character would walk back to it";
  EXPECT_EQ(said[0].open().constraints(0).constraint_id(), 2U);
}

TEST(SessionState, KeepFramesBeyondTheTimelinesMaximumIsRefused) {
  SessionOptions options;
  for (const std::uint32_t fits : {0U, TimelineOptions::kMostKept, TimelineOptions::kKeepAll}) {
    options.keep_frames = fits;
    EXPECT_TRUE(convert::check(options)) << fits;
  }
  options.keep_frames = TimelineOptions::kMostKept + 1;
  const Status refused = convert::check(options);
  EXPECT_EQ(refused.code(), Code::invalid_argument) << "else the session would end when it opens";
  EXPECT_NE(refused.message().find("keep_frames"), std::string::npos);
}

}  // namespace
}  // namespace motiongen
