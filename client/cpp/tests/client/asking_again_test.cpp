// A server that takes a session and ends it at once: each attempt to go on waits longer, until frames come.
#include <gtest/gtest.h>

#include <set>

#include "client/backoff.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr double kSoonS = 0.062;  // above the first wait with the most jitter, below the second with the least

// A session that a server opens, or resumes if it is durable.
struct Asking : Stage {
  double now_s = 0;

  explicit Asking(bool is_durable) {
    open();
    hear_opened(is_durable ? "t" : "");
    v1::SessionUpdate update;
    update.mutable_durability()->set_is_kept(is_durable);
    hear(update);
  }

  // The server ends the session, and opens it when it is asked again. Returns after how many seconds that was.
  double end_and_open() {
    v1::SessionUpdate update;
    update.mutable_closed()->set_reason(v1::CLOSE_REASON_ENGINE_FAULT);
    update.mutable_closed()->set_code(static_cast<int>(Code::unavailable));
    return ask_again(update);
  }

  double ask_again(const v1::SessionUpdate& end) {
    state.take(end, known, now_s, events, outbox);
    EXPECT_EQ(state.phase, Phase::waiting) << state.ended.message();
    const double wait_s = state.retry_at_s - now_s;
    now_s = state.retry_at_s;
    open();
    hear_opened(state.is_durable ? "t" : "");
    EXPECT_EQ(state.phase, Phase::open) << state.ended.message();
    return wait_s;
  }

  void play() {
    const std::vector<float> rows(state.rig.row_width);
    v1::FrameChunk message;
    message.set_plan(state.timeline->plan() + 1);
    message.set_first_frame(state.timeline->received_to());
    message.set_frame_count(1);
    message.set_scalar_type(v1::SCALAR_TYPE_F32_LE);
    message.set_data(rows.data(), rows.size() * sizeof(float));
    wire::Plan plan;
    plan.plan = message.plan();
    plan.valid_from = message.first_frame();
    state.take_plan(plan, events, outbox);
    const std::string bytes = message.SerializeAsString();
    const wire::Piece piece{reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()};
    wire::Chunk chunk;
    ASSERT_TRUE(wire::read_chunk(wire::Cursor(&piece, bytes.size()), chunk));
    state.take_chunk(chunk, events, outbox);
    ASSERT_EQ(state.phase, Phase::open) << state.ended.message();
  }
};

TEST(AskingAgain, SessionEndedAfterEachOpeningIsAskedForMoreAndMoreRarelyUntilFramesCome) {
  for (const bool is_durable : {false, true}) {
    Asking stage(is_durable);
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    EXPECT_LT(stage.end_and_open(), kSoonS);
    double wait_s = 0;
    for (int time = 0; time < 30; ++time) wait_s = stage.end_and_open();
    EXPECT_GT(wait_s, 0.7 * Backoff::kMostS) << "that it was opened thirty times means nothing";
    stage.play();
    EXPECT_LT(stage.end_and_open(), kSoonS) << "frames came: it may have served well for hours";
    EXPECT_GT(stage.end_and_open(), kSoonS);
  }
}

TEST(AskingAgain, RefusalsAreWaitedForAsLongAsTheServerAsksOrLonger) {
  Asking stage(false);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  v1::SessionUpdate refused;
  refused.mutable_outcome()->set_event_seq(1);
  refused.mutable_outcome()->set_code(static_cast<int>(Code::resource_exhausted));
  double wait_s = 0;
  for (int time = 0; time < 30; ++time) {
    stage.lose();
    stage.open();
    wait_s = stage.ask_again(refused);
  }
  EXPECT_GT(wait_s, 0.7 * Backoff::kMostS);
  refused.mutable_outcome()->mutable_retry_after()->set_seconds(7);
  stage.lose();
  stage.open();
  EXPECT_NEAR(stage.ask_again(refused), 7, 1e-6);
}

TEST(AskingAgain, SessionsEndedTogetherAreNotAllAskedForAtTheSameMoment) {
  std::set<double> waits_s;
  for (int number = 0; number < 10; ++number) {
    Asking stage(false);
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    waits_s.insert(stage.end_and_open());
  }
  EXPECT_GT(waits_s.size(), 5U);
}

}  // namespace
}  // namespace motiongen
