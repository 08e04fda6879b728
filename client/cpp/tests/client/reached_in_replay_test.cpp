// Results of targets after a session resumes: of the one that has the id now, or of one that it replaced.
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kSeqOfEdit = 2;  // follows the opening

// An open session with target 1, which is set, and replaced.
struct Replacing : Stage {
  static constexpr std::uint32_t kTarget = 1;
  static constexpr std::uint64_t kFormerAt = 30;
  static constexpr std::uint64_t kTakesEffectAt = 40;

  Replacing() {
    open();
    hear_opened();
    hold(10);
    set(kFormerAt);
    hear_answer(kSeqOfEdit);
  }

  void set(std::uint64_t frame, bool at_any_frame = false) {
    v1::Constraint constraint;
    constraint.set_frame(frame);
    constraint.set_at_any_frame(at_any_frame);
    constraint.mutable_waypoint();
    set(std::move(constraint));
  }

  void set(v1::Constraint constraint) {
    constraint.set_constraint_id(kTarget);
    v1::SessionEvent event;
    *event.mutable_edit_constraints()->add_upsert() = std::move(constraint);
    state.reached_book.forget(kTarget);
    state.send_edit(std::move(event), outbox, events);
  }

  void resume() {
    lose();
    open();
    hear_opened();
  }

  // first_frame: of its placement; 0: the answer has none.
  void hear_answer(std::uint64_t seq, Code code = Code::ok, std::uint64_t first_frame = 0) {
    v1::SessionUpdate update;
    update.mutable_outcome()->set_effective_frame(kTakesEffectAt);
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

  // One more frame of the plan.
  void hear_frame() {
    const std::string row(state.rig.row_width * sizeof(float), '\0');
    const wire::Piece piece{reinterpret_cast<const std::uint8_t*>(row.data()), row.size()};
    wire::Chunk chunk;
    chunk.data = wire::Cursor(&piece, row.size());
    chunk.scalar_type = v1::SCALAR_TYPE_F32_LE;
    chunk.header = {1, state.timeline->received_to(), 1, 0};
    state.take_chunk(chunk, events, outbox);
    ASSERT_EQ(state.phase, Phase::open);
  }

  std::vector<std::uint64_t> reported() {
    std::vector<std::uint64_t> frames;
    for (Event event; events.take(event);) {
      if (event.kind == EventKind::reached) frames.push_back(event.reached.frame);
    }
    return frames;
  }
};

TEST(ReachedInReplay, ResultAfterTheAnswerToAReplacementIsOfTheReplacedTarget) {
  for (const std::uint64_t placed_at : {0U, 40U}) {
    Replacing stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.set(placed_at == 0 ? 900 : 0, placed_at != 0);
    stage.resume();  // while the result of the first and the answer to the second are under way
    stage.hear_answer(kSeqOfEdit + 1, Code::ok, placed_at);
    stage.hear_reached(30);
    EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget));
    EXPECT_TRUE(stage.state.book.expects(Replacing::kTarget)) << "a reopened session must be sent it";
    stage.hear_reached(900);
    ASSERT_TRUE(stage.state.reached_book.find(Replacing::kTarget));
    EXPECT_FALSE(stage.state.book.expects(Replacing::kTarget));
    EXPECT_EQ(stage.reported(), (std::vector<std::uint64_t>{30, 900})) << "the application gets both";
  }
}

TEST(ReachedInReplay, ResultOfAReplacedTargetIsNotOfItsReplacement) {
  Replacing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.set(900);
  stage.resume();
  stage.hear_answer(kSeqOfEdit + 1);
  stage.set(50);
  stage.hear_reached(30);
  stage.hear_answer(kSeqOfEdit + 2, Code::failed_precondition);
  EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget)) << "the second is in force, and still ahead";
  EXPECT_TRUE(stage.state.book.expects(Replacing::kTarget));
}

v1::Constraint range() {
  v1::Constraint made;
  made.set_frame(20);
  made.set_last_frame(900);
  made.mutable_waypoint();
  return made;
}

v1::Constraint trajectory() {
  v1::Constraint made;
  made.set_frame(20);
  for (int number = 0; number < 2 * 41; ++number) made.mutable_root_trajectory()->add_positions(0);
  return made;
}

v1::Constraint earlier() {
  v1::Constraint made;
  made.set_frame(Replacing::kFormerAt - 2);
  made.mutable_waypoint();
  return made;
}

TEST(ReachedInReplay, ResultAtAFrameNotOfTheReplacementIsOfTheReplacedTarget) {
  const std::pair<v1::Constraint, std::uint64_t> cases[] = {
      {range(), 50}, {range(), 900}, {trajectory(), 60}, {earlier(), Replacing::kFormerAt - 2}};
  for (const auto& [constraint, reported_at] : cases) {
    Replacing stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.set(constraint);
    stage.resume();
    stage.hear_answer(kSeqOfEdit + 1);
    stage.hear_reached(Replacing::kFormerAt);
    EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget));
    EXPECT_TRUE(stage.state.book.expects(Replacing::kTarget)) << "a reopened session must be sent it";
    stage.hear_reached(reported_at);
    const auto found = stage.state.reached_book.find(Replacing::kTarget);
    ASSERT_TRUE(found);
    EXPECT_EQ(found->frame, reported_at);
  }
}

TEST(ReachedInReplay, ResultIsOfTheReplacedTargetIfTheConnectionWasLostAgainBeforeItCame) {
  Replacing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.set(range());
  stage.resume();
  stage.hear_answer(kSeqOfEdit + 1);
  stage.resume();  // this time the answer is known, so the server tells of the target alone
  stage.hear_reached(Replacing::kFormerAt);
  EXPECT_FALSE(stage.state.reached_book.find(Replacing::kTarget));
  stage.hear_reached(Replacing::kTakesEffectAt + 1);
  EXPECT_TRUE(stage.state.reached_book.find(Replacing::kTarget));
}

TEST(ReachedInReplay, ResultAfterNewFramesIsOfTheReplacement) {
  Replacing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.set(range());
  stage.resume();
  stage.hear_answer(kSeqOfEdit + 1);
  stage.hear_frame();
  stage.hear_reached(Replacing::kTakesEffectAt - 1);
  EXPECT_TRUE(stage.state.reached_book.find(Replacing::kTarget)) << "no result of the replaced target can still come";
}

TEST(ReachedInReplay, ResultIsOfAReplacementAnsweredBeforeTheLoss) {
  Replacing stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.set(range());
  stage.hear_answer(kSeqOfEdit + 1);
  stage.resume();
  stage.hear_reached(Replacing::kTakesEffectAt - 1);
  EXPECT_TRUE(stage.state.reached_book.find(Replacing::kTarget));
}

}  // namespace
}  // namespace motiongen
