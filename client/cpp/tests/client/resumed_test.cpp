// A resumed session: the messages that follow show what happened while its connection was lost.
#include <vector>

#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kSeqOfEdit = 2;  // follows the opening
constexpr std::uint64_t kCutAt = 20;

v1::SessionEvent teleport() {
  v1::SessionEvent event;
  event.mutable_seek()->mutable_start_pose()->set_x(5);
  return event;
}

// An open session with a requested cut.
struct Cutting : Stage {
  Cutting() {
    open();
    hear_opened();
    state.send_edit(teleport(), outbox, events);
  }

  void hear_answer(Code code = Code::ok) {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_event_seq(kSeqOfEdit);
    update.mutable_outcome()->set_effective_frame(kCutAt);
    update.mutable_outcome()->set_code(static_cast<int>(code));
    hear(update);
  }
};

// The cuts that the timeline has below a frame.
std::vector<std::uint64_t> cuts(const Timeline& timeline, std::uint64_t end) {
  std::vector<std::uint64_t> found;
  for (std::uint64_t frame = 0; frame < end; ++frame) {
    if (timeline.is_cut(frame)) found.push_back(frame);
  }
  return found;
}

TEST(Resumed, CutMadeWhileDisconnectedIsKnownFromItsAnswer) {
  Cutting stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.lose();
  stage.open();
  stage.hear_opened();
  ASSERT_EQ(stage.state.phase, Phase::open);
  ASSERT_TRUE(stage.state.timeline->announce_plan(3, 0));    // one plan for all: its cause is RESUME
  for (int time = 0; time < 2; ++time) stage.hear_answer();  // repeated at each resume
  EXPECT_EQ(cuts(*stage.state.timeline, 40), (std::vector<std::uint64_t>{kCutAt})) << "or it would be blended over";
  EXPECT_EQ(stage.state.timeline->cut_before(30), kCutAt) << "or frames from before it would be history of after it";
}

TEST(Resumed, PassedCutShowsAtTheNextFrameAndIsSentAgainIfReopened) {
  Cutting stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hold(40);
  stage.lose();
  ASSERT_TRUE(stage.state.timeline->advance_to(30));  // by the application, while disconnected
  stage.open();
  stage.hear_opened();
  ASSERT_TRUE(stage.state.timeline->announce_plan(3, 10));
  stage.hear_answer();
  EXPECT_EQ(cuts(*stage.state.timeline, 40), (std::vector<std::uint64_t>{31}));
  stage.lose();  // before any frame after the cut has come
  stage.open();
  stage.hear_refused(Code::not_found);
  stage.sent();
  stage.open();
  const auto cut = stage.sent(v1::SessionEvent::kSeek);
  ASSERT_EQ(cut.size(), 1U);
  EXPECT_EQ(cut[0].seek().start_pose().x(), 5);
}

TEST(Resumed, RefusedCutIsNotACut) {
  Cutting stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(Code::failed_precondition);
  EXPECT_TRUE(cuts(*stage.state.timeline, 40).empty());
}

// What a session sends when it resumes at a server which accepts less, with two edits made in the meantime: the
// first of them fits.
std::vector<v1::SessionEvent> said_where_less_is_accepted(Stage& stage, bool is_closed_meanwhile) {
  stage.open();
  stage.hear_opened();
  stage.lose();
  for (const std::size_t length : {10U, 3000U}) {
    v1::SessionEvent event;
    event.mutable_edit_prompts()->add_upsert()->set_text(std::string(length, 'x'));
    stage.state.send_edit(event, stage.outbox, stage.events);
  }
  stage.known.limits.max_request_bytes = 2048;
  stage.open();
  if (is_closed_meanwhile) stage.state.send_close(stage.outbox);
  stage.sent();
  stage.hear_opened();
  return stage.sent();
}

TEST(Resumed, SessionWithAnEditTooBigToRepeatIsClosedAtTheNextNumber) {
  for (const bool is_closed_meanwhile : {false, true}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    const auto said = said_where_less_is_accepted(stage, is_closed_meanwhile);
    ASSERT_EQ(said.size(), 2U);
    EXPECT_TRUE(said[0].has_edit_prompts());
    EXPECT_EQ(said[0].event_seq(), kSeqOfEdit);
    EXPECT_TRUE(said[1].has_close());
    EXPECT_EQ(said[1].event_seq(), kSeqOfEdit + 1) << "or the server refuses it as a gap, and the session stays there";
    EXPECT_EQ(stage.state.phase, is_closed_meanwhile ? Phase::closing : Phase::closed);
    EXPECT_EQ(stage.num_closed(), is_closed_meanwhile ? 0 : 1);
  }
}

TEST(Resumed, ServiceLevelIsFullAgainUntilTheServerReportsLess) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  v1::SessionUpdate less;
  less.mutable_service_level()->set_tier(v1::SERVICE_TIER_FEWER_STEPS);
  less.mutable_service_level()->set_denoise_steps(2);
  stage.hear(less);
  for (const std::size_t expected : {1U, 0U}) {
    for (Event event; stage.events.take(event);) continue;
    stage.lose();
    stage.open();
    stage.hear_opened();  // by another server, say, that has less to do
    std::vector<std::uint32_t> tiers;
    for (Event event; stage.events.take(event);) {
      if (event.kind == EventKind::service_level) tiers.push_back(event.level.tier);
    }
    EXPECT_EQ(tiers, std::vector<std::uint32_t>(expected, v1::SERVICE_TIER_FULL)) << "reported only if it changes";
  }
}

}  // namespace
}  // namespace motiongen
