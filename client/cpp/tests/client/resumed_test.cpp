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

TEST(Resumed, RefusedCutIsNotACut) {
  Cutting stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.hear_answer(Code::failed_precondition);
  EXPECT_TRUE(cuts(*stage.state.timeline, 40).empty());
}

// An open session with target 1, which is set, and replaced.
struct Replacing : Stage {
  static constexpr std::uint32_t kTarget = 1;

  Replacing() {
    open();
    hear_opened();
    hold(10);
    set(30);
    hear_answer(kSeqOfEdit);
  }

  void set(std::uint64_t frame, bool at_any_frame = false) {
    v1::SessionEvent event;
    auto* constraint = event.mutable_edit_constraints()->add_upsert();
    constraint->set_constraint_id(kTarget);
    constraint->set_frame(frame);
    constraint->set_at_any_frame(at_any_frame);
    constraint->mutable_waypoint();
    state.reached_book.forget(kTarget);
    state.send_edit(std::move(event), outbox, events);
  }

  // first_frame: of its placement; 0: the answer has none.
  void hear_answer(std::uint64_t seq, Code code = Code::ok, std::uint64_t first_frame = 0) {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_event_seq(seq);
    update.mutable_outcome()->set_code(static_cast<int>(code));
    if (first_frame != 0) {
      auto* placement = update.mutable_outcome()->add_placements();
      placement->set_constraint_id(kTarget);
      placement->set_first_frame(first_frame);
      placement->set_last_frame(first_frame + 100);
    }
    hear(update);
  }

  void hear_reached(std::uint64_t frame) {
    v1::SessionUpdate update;
    update.mutable_constraint_reached()->set_constraint_id(kTarget);
    update.mutable_constraint_reached()->set_frame(frame);
    hear(update);
  }

  std::vector<std::uint64_t> reported() {
    std::vector<std::uint64_t> frames;
    for (Event event; events.take(event);) {
      if (event.kind == EventKind::reached) frames.push_back(event.reached.frame);
    }
    return frames;
  }
};

TEST(Resumed, NewsThatIsToldBehindTheAnswerOfAReplacementIsOfTheTargetBefore) {
  for (const std::uint64_t placed_at : {0U, 40U}) {
    Replacing stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.set(placed_at == 0 ? 900 : 0, placed_at != 0);
    stage.lose();  // with the news of the first, and the answer of the second, under way
    stage.open();
    stage.hear_opened();
    stage.hear_answer(kSeqOfEdit + 1, Code::ok, placed_at);
    stage.hear_reached(30);
    EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget));
    EXPECT_TRUE(stage.state.book.expects(Replacing::kTarget)) << "a session opened anew must be told of it";
    stage.hear_reached(900);
    ASSERT_TRUE(stage.state.reached_book.find(Replacing::kTarget));
    EXPECT_FALSE(stage.state.book.expects(Replacing::kTarget));
    EXPECT_EQ(stage.reported(), (std::vector<std::uint64_t>{30, 900})) << "the application hears both";
  }
}

TEST(Resumed, NewsOfTheOneBeforeIsOfNoneWhoseReplacementIsRefused) {
  Replacing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.set(900);
  stage.lose();
  stage.open();
  stage.hear_opened();
  stage.hear_answer(kSeqOfEdit + 1);
  stage.set(50);
  stage.hear_reached(30);
  stage.hear_answer(kSeqOfEdit + 2, Code::failed_precondition);
  EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget)) << "the second applies, and is ahead";
  EXPECT_TRUE(stage.state.book.expects(Replacing::kTarget));
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
