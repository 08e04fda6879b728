#include "client/book.hpp"

#include <gtest/gtest.h>

#include "client/convert.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostPrompts = 16;

SessionBook new_book() {
  v1::OpenSession open;
  open.mutable_start_pose()->set_x(3);
  *open.add_prompts() = convert::span(SessionBook::kPresentPrompt, Prompt("walk"), 0, 0);
  SessionBook book(1, std::move(open));
  book.add_opening(convert::constraint(book.take_constraint_id(), Waypoint{100, 1, 2, {}, {}}));
  static_cast<void>(book.take_seq());
  book.opened({});
  return book;
}

v1::SessionEvent prompt_event(std::uint32_t id, const char* text, std::uint64_t start, std::uint64_t end = 0) {
  v1::SessionEvent event;
  *event.mutable_edit_prompts()->add_upsert() = convert::span(id, Prompt(text), start, end);
  return event;
}

TEST(SessionBook, ReopeningHasAllAcceptedEditsWithFramesFromTheNewStart) {
  SessionBook book = new_book();
  v1::SessionEvent later = prompt_event(2, "run", 90);
  EXPECT_EQ(book.add(later), 1U);
  EXPECT_EQ(later.event_seq(), 2U);
  EXPECT_EQ(book.answer(2, Taken{}), EditId{1});
  v1::SessionEvent over = prompt_event(3, "jump", 10, 40);
  book.add(over);
  EXPECT_EQ(book.answer(3, Taken{}), EditId{2});
  const v1::OpenSession open = book.reopening(60, 8, "rows", kMostPrompts);
  ASSERT_EQ(open.prompts_size(), 2);
  EXPECT_EQ(open.prompts(0).text(), "walk");
  EXPECT_EQ(open.prompts(1).text(), "run");
  EXPECT_EQ(open.prompts(1).start_frame(), 30U);
  ASSERT_EQ(open.constraints_size(), 1);
  EXPECT_EQ(open.constraints(0).frame(), 40U);
  EXPECT_FALSE(open.has_start_pose());
  EXPECT_EQ(open.prior_frames().frame_count(), 8U);
  EXPECT_EQ(open.prior_frames().data(), "rows");
}

TEST(SessionBook, RefusedEditsAreLeftOutAndUnansweredOnesSentAgain) {
  SessionBook book = new_book();
  v1::SessionEvent refused = prompt_event(2, "fly", 90);
  v1::SessionEvent open = prompt_event(3, "run", 90);
  book.add(refused);
  book.add(open);
  EXPECT_EQ(book.answer(2, std::nullopt), EditId{1});
  EXPECT_EQ(book.reopening(60, 8, "", kMostPrompts).prompts_size(), 1);
  book.begin_stream();
  static_cast<void>(book.take_seq());
  const auto again = book.unanswered(60);
  ASSERT_EQ(again.size(), 1U);
  EXPECT_EQ(again[0].event_seq(), 2U);
  EXPECT_EQ(again[0].edit_prompts().upsert(0).start_frame(), 30U);
  EXPECT_EQ(book.answer(3, Taken{}), std::nullopt) << "numbers of the earlier stream do not count";
  EXPECT_EQ(book.answer(2, Taken{}), EditId{2});
}

TEST(SessionBook, TrajectoryIsCutToTheFramesAhead) {
  SessionBook book = new_book();
  v1::SessionEvent event;
  const RootTrajectory path{50, {0, 0, 1, 1, 2, 2, 3, 3}, {0.0F, 0.1F, 0.2F, 0.3F}, {}};
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(9, path);
  book.add(event);
  book.answer(2, Taken{});
  const v1::OpenSession open = book.reopening(52, 8, "", kMostPrompts);
  ASSERT_EQ(open.constraints_size(), 2);
  const auto& rest = open.constraints(1);
  EXPECT_EQ(rest.frame(), 0U);
  ASSERT_EQ(rest.root_trajectory().positions_size(), 4);
  EXPECT_EQ(rest.root_trajectory().positions(0), 2);
  EXPECT_EQ(rest.root_trajectory().headings(0), 0.2F);
  EXPECT_EQ(book.reopening(54, 8, "", kMostPrompts).constraints_size(), 1);
}

TEST(SessionBook, KnowsTheIdsOfPresentAndScheduledPrompts) {
  SessionBook book = new_book();
  const std::uint32_t scheduled = book.take_prompt_id();
  EXPECT_TRUE(book.knows_prompt(SessionBook::kPresentPrompt));
  EXPECT_TRUE(book.knows_prompt(scheduled));
  for (const std::uint32_t id : {0U, scheduled + 1}) EXPECT_FALSE(book.knows_prompt(id)) << id;
}

TEST(SessionBook, KnowsWhichScheduledPromptsHaveBegun) {
  SessionBook book = new_book();
  for (const std::uint64_t start : {30, 10, 70}) {
    v1::SessionEvent event = prompt_event(book.take_prompt_id(), "x", start);
    book.add(event);
    book.answer(event.event_seq(), Taken{});
  }
  EXPECT_EQ(book.begun_prompts(40, true), (std::vector<std::uint32_t>{3}));
  EXPECT_EQ(book.begun_prompts(40, false), (std::vector<std::uint32_t>{3, 2})) << "the removal has not been sent yet";
}

TEST(SessionBook, PromptWithAnUnansweredChangeIsNotRemovedAgain) {
  SessionBook book = new_book();
  for (int number = 0; number < 2; ++number) {
    v1::SessionEvent event = prompt_event(book.take_prompt_id(), "x", 10);
    book.add(event);
    book.answer(event.event_seq(), Taken{});
  }
  v1::SessionEvent removal;
  removal.mutable_edit_prompts()->add_remove(2);
  v1::SessionEvent replacement = prompt_event(3, "y", 300);
  v1::SessionEvent again = prompt_event(3, "z", 20);
  for (v1::SessionEvent* each : {&removal, &replacement, &again}) book.add(*each);
  EXPECT_TRUE(book.begun_prompts(40, false).empty()) << "their changes are not answered yet";
  book.answer(removal.event_seq(), std::nullopt);
  EXPECT_EQ(book.begun_prompts(40, false), (std::vector<std::uint32_t>{2}))
      << "its removal was refused, so it is still there";
  book.answer(replacement.event_seq(), Taken{});
  EXPECT_EQ(book.begun_prompts(40, false), (std::vector<std::uint32_t>{2})) << "another change is unanswered";
  book.answer(again.event_seq(), Taken{});
  EXPECT_EQ(book.begun_prompts(40, false), (std::vector<std::uint32_t>{2, 3}));
}

TEST(SessionBook, PromptWithAnEndIsNeverDroppedForAnother) {
  SessionBook book = new_book();
  v1::SessionEvent event = prompt_event(book.take_prompt_id(), "wave", 10, 90);
  book.add(event);
  book.answer(event.event_seq(), Taken{});
  EXPECT_TRUE(book.begun_prompts(40, false).empty());
}

TEST(SessionBook, ReplacedTargetIsNotKeptBesideItsReplacement) {
  SessionBook book = new_book();
  v1::SessionEvent event;
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(1, Waypoint{120, 7, 8, {}, {}});
  book.add(event);
  book.answer(2, Taken{});
  const v1::OpenSession open = book.reopening(60, 8, "", kMostPrompts);
  ASSERT_EQ(open.constraints_size(), 1);
  EXPECT_EQ(open.constraints(0).frame(), 60U);
  EXPECT_EQ(open.constraints(0).waypoint().x(), 7);
}

TEST(SessionBook, PlacedTargetIsSentWithTheFramesAndPlaceOfItsPlacement) {
  SessionBook book = new_book();
  v1::SessionEvent event;
  Target there = Waypoint{10, 1, 2, 0.5F, {}};
  there.last_frame = 40;
  there.frames_from_effect = there.relative_to_character = true;
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(2, there);
  book.add(event);
  Placement placement;
  placement.target = 2;
  placement.anchor_frame = 50;
  placement.first_frame = 60;
  placement.last_frame = 90;
  placement.anchor_x_m = 10;
  placement.anchor_z_m = 20;
  placement.anchor_heading_rad = 1.57079632679F;  // it faces +X, and its left is -Z
  book.answer(2, Taken{50, {placement}});
  const v1::OpenSession open = book.reopening(70, 8, "", kMostPrompts);
  ASSERT_EQ(open.constraints_size(), 2);
  const v1::Constraint& held = open.constraints(1);
  EXPECT_EQ(held.frame(), 0U);
  EXPECT_EQ(held.last_frame(), 20U);
  EXPECT_FALSE(held.frames_from_effect());
  EXPECT_FALSE(held.relative_to_character());
  EXPECT_NEAR(held.waypoint().x(), 12, 1e-5);
  EXPECT_NEAR(held.waypoint().z(), 19, 1e-5);
  EXPECT_NEAR(held.waypoint().heading(), 2.0708, 1e-4);
  EXPECT_EQ(book.reopening(91, 8, "", kMostPrompts).constraints_size(), 1);
}

TEST(SessionBook, PathKeepsOnlyTheCornersAhead) {
  SessionBook book = new_book();
  v1::SessionEvent event;
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(2, RootPath{{0, 1, 0, 2, 0, 4}, {}, {}, {}});
  book.add(event);
  Placement placement;
  placement.target = 2;
  placement.first_frame = 100;
  placement.last_frame = 200;
  book.answer(2, Taken{100, {placement}});
  const v1::OpenSession open = book.reopening(160, 8, "", kMostPrompts);
  ASSERT_EQ(open.constraints_size(), 1);  // the waypoint at 100 has passed
  ASSERT_EQ(open.constraints(0).root_path().positions_size(), 2);
  EXPECT_EQ(open.constraints(0).root_path().positions(1), 4);
}

TEST(SessionBook, VelocitiesAndCutsAheadAreRepeatedAfterReopening) {
  SessionBook book = new_book();
  v1::SessionEvent velocity;
  velocity.mutable_set_velocity()->set_z(1);
  velocity.mutable_set_velocity()->set_hold_frames(30);
  v1::SessionEvent cut;
  cut.mutable_seek()->mutable_start_pose()->set_x(5);
  v1::SessionEvent options;
  options.mutable_set_options()->set_denoise_steps(4);
  options.mutable_set_options()->set_priority(v1::PRIORITY_CLASS_HERO);
  for (v1::SessionEvent* each : {&velocity, &cut, &options}) book.add(*each);
  book.answer(2, Taken{50, {}});
  book.answer(3, Taken{70, {}});
  book.answer(4, Taken{});
  const v1::OpenSession open = book.reopening(65, 8, "", kMostPrompts);
  EXPECT_EQ(open.denoise_steps(), 4U);
  EXPECT_EQ(open.priority(), v1::PRIORITY_CLASS_HERO);
  book.begin_stream();
  static_cast<void>(book.take_seq());
  const auto again = book.unanswered(65);
  ASSERT_EQ(again.size(), 2U);
  EXPECT_EQ(again[0].seek().start_pose().x(), 5) << "the cut at 70 has not come yet";
  EXPECT_EQ(again[1].set_velocity().hold_frames(), 15U);
  book.begin_stream();
  static_cast<void>(book.take_seq());
  EXPECT_TRUE(book.unanswered(90).empty()) << "the velocity is over, the cut was shown";
}

TEST(SessionBook, SeekFramesAreCountedFromTheNewStart) {
  SessionBook book = new_book();
  v1::SessionEvent seek;
  seek.mutable_seek()->set_frame(90);
  v1::SessionEvent past;
  past.mutable_seek()->set_frame(40);
  for (v1::SessionEvent* each : {&seek, &past}) book.add(*each);
  book.begin_stream();
  static_cast<void>(book.take_seq());
  auto again = book.unanswered(65);
  ASSERT_EQ(again.size(), 2U);
  EXPECT_EQ(again[0].seek().frame(), 25U);
  EXPECT_GT(again[1].seek().frame(), 1ULL << 50) << "without rows for it, the server is to refuse it";
  book.change_seeks([](v1::Seek& each) {
    if (each.frame() == 40) each.clear_frame();
  });
  again = book.repetitions(65);
  EXPECT_EQ(again[0].seek().frame(), 25U);
  EXPECT_EQ(again[1].seek().frame(), 0U);
}

TEST(SessionBook, AcceptedPauseIsRepeatedOnceAtEachReopening) {
  SessionBook book = new_book();
  v1::SessionEvent event;
  event.mutable_set_play_state()->set_state(v1::PLAY_STATE_PAUSED);
  book.add(event);
  EXPECT_FALSE(book.is_paused());
  book.answer(2, Taken{});
  EXPECT_TRUE(book.is_paused());
  v1::SessionEvent edit = prompt_event(2, "run", 0);
  book.add(edit);
  for (int loss = 0; loss < 2; ++loss) {
    book.begin_stream();
    static_cast<void>(book.take_seq());
    const auto again = book.unanswered(0);
    ASSERT_EQ(again.size(), 2U) << "the pause is sent once";
    EXPECT_TRUE(again[0].has_set_play_state());
    EXPECT_EQ(again[1].event_seq(), 3U);
  }
  EXPECT_EQ(book.answered_seq(), 1U);
  EXPECT_EQ(book.answer(2, Taken{}), EditId{0});
  EXPECT_EQ(book.answered_seq(), 2U);
}

TEST(SessionBook, UnansweredEditsAreRepeatedUnchangedWhenTheSessionIsResumed) {
  SessionBook book = new_book();
  v1::SessionEvent first = prompt_event(2, "run", 90);
  v1::SessionEvent second = prompt_event(3, "wave", 95);
  book.add(first);
  book.add(second);
  book.answer(2, Taken{});
  const auto again = book.repetitions(0);
  ASSERT_EQ(again.size(), 1U);
  EXPECT_EQ(again[0].SerializeAsString(), second.SerializeAsString());
  EXPECT_EQ(book.answered_seq(), 2U);
}

TEST(SessionBook, SessionThatNeverOpenedIsOpenedUnchanged) {
  v1::OpenSession first;
  first.set_model_id("m");
  *first.add_prompts() = convert::span(1, Prompt("walk"), 0, 0);
  const SessionBook book(1, first);
  EXPECT_EQ(book.reopening(0, 0, "", kMostPrompts).SerializeAsString(), first.SerializeAsString());
}

}  // namespace
}  // namespace motiongen
