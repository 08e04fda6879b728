// However much a server sends with an answer, the client keeps a bounded part of it, and says what it left out.
#include <gtest/gtest.h>

#include "client/clip_sample.hpp"
#include "client/convert.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostBytes = 4096;
constexpr std::size_t kMostWarnings = 64;
constexpr int kMostPlacements = 16384;

// Whether a text of so many bytes was cut, and says so.
bool is_cut(const std::string& kept, std::size_t given) {
  const std::string note = "... (" + std::to_string(given - kMostBytes) + " more bytes were left out)";
  return kept == std::string(kMostBytes, 'x') + note;
}

TEST(KeptAnswers, LongTextsAreCutAndSayHowMuchIsMissing) {
  const std::string text(10'000, 'x');
  v1::EditOutcome message;
  message.set_code(static_cast<int>(Code::not_found));
  message.set_reason(text);
  message.set_message(text);
  message.set_field(text);
  message.set_allowed(text);
  message.add_other_servers()->set_address(text);
  message.mutable_other_servers(0)->set_routing_key(text);
  const Outcome told = convert::outcome(message);
  for (const std::string& each : {told.status.reason(), told.status.message(), told.field, told.allowed,
                                  told.other_servers[0].address, told.other_servers[0].routing_key}) {
    EXPECT_TRUE(is_cut(each, text.size())) << each.size();
  }
  v1::SessionOpened opened;
  opened.set_session_id(text);
  opened.set_model_id(text);
  opened.set_rig_id(text);
  const Opened begun = convert::opened(opened);
  for (const std::string& each : {begun.session_id, begun.model_id, begun.rig_id}) {
    EXPECT_TRUE(is_cut(each, text.size())) << each.size();
  }
  v1::SessionClosed closed;
  closed.set_message(text);
  EXPECT_TRUE(is_cut(convert::closed(closed).message(), text.size()));
}

TEST(KeptAnswers, TextThatFitsIsKeptWhole) {
  v1::EditOutcome message;
  message.set_code(static_cast<int>(Code::not_found));
  message.set_allowed(std::string(kMostBytes, 'x'));
  EXPECT_EQ(convert::outcome(message).allowed.size(), kMostBytes);
}

TEST(KeptAnswers, FirstWarningsAreKeptAndTheLastOneCountsTheOthers) {
  v1::EditOutcome message;
  for (std::size_t number = 0; number < kMostWarnings; ++number) {
    message.add_warnings()->set_message(std::to_string(number));
  }
  EXPECT_EQ(convert::outcome(message).warnings.back().message, "63");
  for (int more = 0; more < 936; ++more) message.add_warnings()->set_reason("UNTRAINED_SPEED");
  const auto kept = convert::outcome(message).warnings;
  ASSERT_EQ(kept.size(), kMostWarnings + 1);
  EXPECT_EQ(kept[kMostWarnings - 1].message, "63");
  EXPECT_EQ(kept.back().reason, "WARNINGS_LEFT_OUT");
  EXPECT_NE(kept.back().message.find("936"), std::string::npos);
}

TEST(KeptAnswers, AnswerWithTooManyPlacementsClosesTheSession) {
  for (const int count : {kMostPlacements, kMostPlacements + 1}) {
    v1::SessionUpdate opened;
    opened.mutable_opened()->set_rig_id("r");
    opened.mutable_opened()->set_model_id("m");
    v1::SessionUpdate outcome;
    outcome.mutable_outcome()->set_event_seq(2);
    for (int number = 0; number < count; ++number) {
      opened.mutable_opened()->add_placements();
      outcome.mutable_outcome()->add_placements();
    }
    for (const v1::SessionUpdate* update : {&opened, &outcome}) {
      Stage stage;
      const std::lock_guard<std::mutex> lock(stage.state.mutex);
      stage.open();
      if (update == &outcome) stage.hear_opened();
      stage.hear(*update);
      EXPECT_EQ(stage.state.ended.reason(), count > kMostPlacements ? "PROTOCOL_VIOLATION" : "");
    }
    v1::GenerateClipResponse part;
    *part.mutable_opened() = opened.opened();
    ClipSample sample;
    EXPECT_EQ(static_cast<bool>(sample.take(part, catalog(), {})), count == kMostPlacements);
  }
}

TEST(KeptAnswers, TooLongTokenClosesTheSession) {
  for (const bool is_resumed : {false, true}) {
    for (const std::size_t bytes : {kMostBytes, kMostBytes + 1}) {
      Stage stage;
      stage.known.limits.max_request_bytes = 1 << 20;
      const std::lock_guard<std::mutex> lock(stage.state.mutex);
      stage.open();
      if (is_resumed) {
        stage.hear_opened();
        stage.lose();
        stage.open();
      }
      stage.hear_opened(std::string(bytes, 't').c_str());
      EXPECT_EQ(stage.state.ended.reason(), bytes > kMostBytes ? "PROTOCOL_VIOLATION" : "");
    }
  }
}

Outcome refused(std::size_t bytes) {
  Outcome outcome;
  outcome.status = Status(Code::not_found, "", std::string(bytes, 'x'));
  return outcome;
}

TEST(KeptAnswers, AnswersAreKeptByNumberAndByMemory) {
  AnswerBook small;
  AnswerBook big;
  for (EditId edit = 1; edit <= AnswerBook::kMost + 1; ++edit) {
    small.note(edit, edit, refused(0));
    big.note(edit, edit, refused(AnswerBook::kMostBytes / 8));
  }
  EXPECT_FALSE(small.find(1));
  EXPECT_TRUE(small.find(2));
  EXPECT_FALSE(big.find(AnswerBook::kMost + 1 - 8));
  EXPECT_TRUE(big.find(AnswerBook::kMost + 1 - 6));
  big.note(5000, 5000, refused(2 * AnswerBook::kMostBytes));
  EXPECT_TRUE(big.find(5000)) << "the newest is kept in any case";
}

TEST(KeptAnswers, EventsThatNobodyTakesAreCountedOnceTheirTextsTakeTooMuchMemory) {
  EventQueue events{nullptr};
  for (int number = 0; number < 80; ++number) {
    Event event;
    event.edit = static_cast<EditId>(number);
    event.outcome = refused(1 << 20);
    events.push(std::move(event));
  }
  const std::uint64_t num_dropped = events.num_dropped();
  EXPECT_GT(num_dropped, 15U);
  EXPECT_LT(num_dropped, 20U);
  Event event;
  ASSERT_TRUE(events.take(event));
  EXPECT_EQ(event.edit, num_dropped) << "the oldest are dropped";
  int num_left = 1;
  while (events.take(event)) ++num_left;
  EXPECT_EQ(num_left, 80 - static_cast<int>(num_dropped));
}

}  // namespace
}  // namespace motiongen
