// A playhead that its caller moves faster than in real time, and edits meanwhile.
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kHeldTo = 40;
constexpr std::uint64_t kCommittedTo = 12;
constexpr std::uint64_t kSeqOfEdit = 2;  // follows the opening

SessionOptions played_by(Clock clock) {
  SessionOptions options;
  options.clock = clock;
  return options;
}

// An open session that holds frames.
struct Playing : Stage {
  explicit Playing(Clock clock = Clock::manual) : Stage({}, played_by(clock)) {
    open();
    hear_opened();
    hold(kHeldTo, kCommittedTo);
    static_cast<void>(sent());
  }

  void tell() {
    v1::SessionEvent event;
    event.mutable_set_velocity()->set_x(1);
    state.send_edit(std::move(event), outbox, events);
  }

  void hear_answer() {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_event_seq(kSeqOfEdit);
    hear(update);
  }

  // Expects that a report of this frame was sent, directly followed by the edit.
  void expect_told_at(std::uint64_t frame) {
    const auto said = sent();
    ASSERT_GE(said.size(), 2U);
    EXPECT_EQ(said.back().event_case(), v1::SessionEvent::kSetVelocity);
    const v1::SessionEvent& before = said[said.size() - 2];
    ASSERT_EQ(before.event_case(), v1::SessionEvent::kPlayhead);
    EXPECT_EQ(before.playhead().frame(), frame);
  }
};

TEST(TakenAhead, EveryHeldFrameMayBeShownWithoutAnEdit) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  EXPECT_EQ(stage.state.showable_to(), kHeldTo);
  EXPECT_TRUE(stage.state.advance_to(kHeldTo - 1));
  EXPECT_EQ(stage.state.advance_to(kHeldTo).reason(), "FRAME_NOT_HELD");
}

TEST(TakenAhead, OnlyCommittedFramesAreShownWhileAnEditIsUnanswered) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  ASSERT_TRUE(stage.state.advance_to(5));
  stage.tell();
  stage.expect_told_at(5);
  EXPECT_TRUE(stage.state.advance_to(kCommittedTo - 1));
  const Status refused = stage.state.advance_to(kCommittedTo);
  EXPECT_EQ(refused.code(), Code::out_of_range);
  EXPECT_EQ(refused.reason(), "EDIT_UNANSWERED");
  EXPECT_NE(refused.message().find("from 12 on"), std::string::npos) << refused.message();
  EXPECT_EQ(stage.state.timeline->playhead(), kCommittedTo - 1);
  EXPECT_EQ(stage.state.advance_to(kHeldTo).reason(), "FRAME_NOT_HELD");
  stage.hear_answer();
  EXPECT_TRUE(stage.state.advance_to(kHeldTo - 1));
}

TEST(TakenAhead, FrameAlreadyShownMayBeShownAgainAlthoughNotCommitted) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  ASSERT_TRUE(stage.state.advance_to(20));
  stage.tell();
  stage.expect_told_at(20);
  EXPECT_EQ(stage.state.showable_to(), 21U);
  EXPECT_TRUE(stage.state.advance_to(20));
  EXPECT_EQ(stage.state.advance_to(21).reason(), "EDIT_UNANSWERED");
}

TEST(TakenAhead, ShowingTheLastCommittedFrameMakesAReportDueAtOnce) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  ASSERT_TRUE(stage.state.advance_to(5));
  stage.tell();
  stage.state.next_report_s = 100;
  ASSERT_TRUE(stage.state.advance_to(kCommittedTo - 2));
  EXPECT_EQ(stage.state.next_report_s, 100);
  ASSERT_TRUE(stage.state.advance_to(kCommittedTo - 1));
  EXPECT_EQ(stage.state.next_report_s, 0);
}

TEST(TakenAhead, HeldFramesPlayWhileDisconnectedAndAreReportedBeforeTheEdit) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  ASSERT_TRUE(stage.state.advance_to(5));
  stage.tell();
  stage.lose();
  EXPECT_TRUE(stage.state.advance_to(30));
  stage.open();
  EXPECT_TRUE(stage.state.advance_to(35));
  static_cast<void>(stage.sent());
  stage.hear_opened();
  stage.expect_told_at(35);
  EXPECT_EQ(stage.state.advance_to(36).reason(), "EDIT_UNANSWERED");
}

TEST(TakenAhead, RealTimePlaybackWaitsForNoAnswerAndSendsNoExtraReport) {
  Playing stage(Clock::real_time);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.tell();
  EXPECT_EQ(stage.state.showable_to(), kHeldTo);
  EXPECT_TRUE(stage.sent(v1::SessionEvent::kPlayhead).empty());
}

TEST(TakenAhead, EditSendsOneReportAndDoesNotBringTheNextForward) {
  Playing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  ASSERT_TRUE(stage.state.advance_to(5));
  stage.state.next_report_s = 100;
  stage.tell();
  stage.expect_told_at(5);
  EXPECT_EQ(stage.state.next_report_s, 100) << "with twice the reports, a stick would exceed its rate limit";
}

}  // namespace
}  // namespace motiongen
