#include "client/session_state.hpp"

#include <gtest/gtest.h>

namespace motiongen {
namespace {

Catalog catalog() {
  Catalog made;
  Rig rig;
  rig.rig_id = "r";
  rig.joint_names = {"Hips"};
  rig.parents = {-1};
  rig.offsets_m = {0, 0, 0};
  rig.frame_rate_hz = 20;
  rig.blocks = {{"root_translation_m", 3}, {"joint_rotation_quat_wxyz", 4}, {"foot_contact", 4}};
  made.rigs = {rig};
  made.models.emplace_back();
  made.models[0].model_id = "m";
  made.models[0].rig_id = "r";
  made.limits.max_request_bytes = 4096;
  return made;
}

// One session and what it meets, without a client.
struct Stage {
  Catalog known = catalog();
  EventQueue events{nullptr};
  Outbox outbox;
  SessionState state;

  explicit Stage(v1::OpenSession open = {}, SessionOptions options = {})
      : state(1, std::move(options), std::move(open), true) {
    outbox.set_limit(known.limits.max_request_bytes);
  }

  void open() { state.send_open(outbox, known, events); }

  void hear(const v1::SessionUpdate& update) { state.take(update, known, 0, events, outbox); }

  void hear_opened(const char* token = "t", const char* rig = "r") {
    v1::SessionUpdate update;
    update.mutable_opened()->set_rig_id(rig);
    update.mutable_opened()->set_model_id("m");
    update.mutable_opened()->set_session_token(token);
    update.mutable_opened()->set_denoise_steps(8);
    hear(update);
  }

  void lose() { state.lose(Status(Code::unavailable, "", "cut"), true, events); }

  // Frames up to one, as if they had come.
  void hold(std::uint64_t end) {
    const std::vector<float> rows(end * state.rig.row_width);
    RowSpan stored({rows.data(), rows.size()});
    ASSERT_TRUE(state.timeline->announce_plan(1, 0, false));
    ASSERT_TRUE(state.timeline->add_chunk({1, 0, static_cast<std::uint32_t>(end), 0}, stored));
  }

  // The events of a kind that wait to be sent, which takes all out.
  std::vector<v1::SessionEvent> sent(v1::SessionEvent::EventCase kind) {
    std::vector<v1::SessionEvent> found;
    for (std::string text; outbox.take(text);) {
      v1::StreamMotionRequest message;
      EXPECT_TRUE(message.ParseFromString(text));
      for (const v1::SessionEvent& each : message.events()) {
        if (each.event_case() == kind) found.push_back(each);
      }
    }
    return found;
  }

  // The answer to its open.
  void hear_refused(Code code) {
    v1::SessionUpdate update;
    auto* outcome = update.mutable_outcome();
    outcome->set_event_seq(1);
    outcome->set_code(static_cast<int>(code));
    outcome->add_other_servers()->set_address("other:1");
    hear(update);
  }

  int num_closed() {
    int count = 0;
    for (Event event; events.take(event);) count += event.kind == EventKind::closed ? 1 : 0;
    return count;
  }
};

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
