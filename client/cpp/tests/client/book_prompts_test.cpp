// Prompts of a session that is reopened: one that has begun stays in force until its replacement begins.
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "client/book.hpp"
#include "client/convert.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostPrompts = 16;

// A book opened with "walk", and the prompts that it gives a session reopened at a frame.
struct Told {
  SessionBook book;

  Told() : book(1, walking()) {
    static_cast<void>(book.take_seq());
    book.opened({});
  }

  static v1::OpenSession walking() {
    v1::OpenSession open;
    *open.add_prompts() = convert::span(SessionBook::kPresentPrompt, Prompt("walk"), 0, 0);
    return open;
  }

  void take(std::uint32_t id, const char* text, const Taken& taken, std::uint64_t start = 0, std::uint64_t end = 0) {
    v1::SessionEvent event;
    *event.mutable_edit_prompts()->add_upsert() = convert::span(id, Prompt(text), start, end);
    book.add(event);
    book.answer(event.event_seq(), taken);
  }

  // Each as its text, its start and its end.
  std::vector<std::string> from(std::uint64_t frame, std::size_t most = kMostPrompts) const {
    std::vector<std::string> told;
    const v1::OpenSession open = book.reopening(frame, 0, "", most);
    for (const v1::PromptSpan& each : open.prompts()) {
      told.push_back(each.text() + " " + std::to_string(each.start_frame()) + " " + std::to_string(each.end_frame()));
    }
    return told;
  }
};

using Spans = std::vector<std::string>;

TEST(BookPrompts, PromptInForceContinuesUntilItsReplacementBegins) {
  Told told;
  told.take(1, "run", {200, {}, 10}, 200);
  EXPECT_EQ(told.from(150), (Spans{"walk 0 50", "run 50 0"}));
  EXPECT_EQ(told.from(150, 1), (Spans{"run 50 0"})) << "fewer prompts may be sent";
  EXPECT_EQ(told.from(200), (Spans{"run 0 0"}));
  told.take(1, "jump", {300, {}, 20}, 300);
  EXPECT_EQ(told.from(150), (Spans{"walk 0 150", "jump 150 0"})) << "\"run\" never began";
  told.take(1, "sit", {40, {}, 30});
  EXPECT_EQ(told.from(35), (Spans{"walk 0 5", "sit 5 0"})) << "the answer names a frame still to come";
}

TEST(BookPrompts, PromptsThatHaveEndedAreForgotten) {
  Told told;
  told.take(2, "wave", {50, {}, 45}, 50, 60);
  EXPECT_EQ(told.from(50), (Spans{"walk 0 0", "wave 0 10"}));
  told.take(3, "nod", {80, {}, 70}, 80, 90);
  EXPECT_EQ(told.from(50), (Spans{"walk 0 0", "nod 30 40"})) << "a long session would keep them all";
}

TEST(BookPrompts, PromptMovedToALaterFrameIsNotDroppedBeforeItBeginsThere) {
  Told told;
  const std::uint32_t id = told.book.take_prompt_id();
  told.take(id, "run", {10, {}, 0}, 10);
  told.take(id, "jump", {300, {}, 20}, 300);
  EXPECT_EQ(told.from(150), (Spans{"walk 0 0", "run 0 150", "jump 150 0"}));
  EXPECT_TRUE(told.book.begun_prompts(150, false).empty());
  EXPECT_EQ(told.book.begun_prompts(300, false), (std::vector<std::uint32_t>{id}));
}

}  // namespace
}  // namespace motiongen
