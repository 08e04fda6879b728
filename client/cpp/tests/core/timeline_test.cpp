#include "motiongen/core/timeline.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/rows.hpp"
#include "core/walk.hpp"

namespace motiongen {
namespace {

using testing::add;
using testing::chain_rig;
using testing::chain_row;
using testing::numbered_rows;
using testing::small_timeline;
using testing::Walk;

float first_number(const Timeline& timeline, std::uint64_t frame) { return timeline.row(frame).value()[0]; }

TEST(Timeline, NewPlanReplacesFramesNotYetShown) {
  Timeline timeline = small_timeline();
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 10));
  timeline.advance(0.0);
  ASSERT_TRUE(timeline.announce_plan(2, 5));
  EXPECT_EQ(timeline.buffered_to(), 5U);
  ASSERT_TRUE(add(timeline, 2, 5, 3));
  EXPECT_EQ(first_number(timeline, 4), 1004);
  EXPECT_EQ(first_number(timeline, 5), 2005);
  EXPECT_EQ(timeline.late_plans(), 0U);
}

TEST(Timeline, LatePlanDoesNotChangeFramesAlreadyShown) {
  Timeline timeline = small_timeline();
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 10));
  timeline.advance(0.0);
  timeline.advance(0.3);  // the playhead is at 6
  ASSERT_TRUE(timeline.announce_plan(2, 4));
  ASSERT_TRUE(add(timeline, 2, 4, 2));
  ASSERT_TRUE(add(timeline, 2, 6, 4));
  EXPECT_EQ(timeline.late_plans(), 1U);
  EXPECT_EQ(first_number(timeline, 6), 1006);
  EXPECT_EQ(first_number(timeline, 7), 2007);
  EXPECT_EQ(timeline.buffered_to(), 10U);
}

TEST(Timeline, ProtocolViolationsAreRefusedAndChangeNothing) {
  Timeline timeline = small_timeline();
  EXPECT_EQ(add(timeline, 0, 0, 10, 4).reason(), "PROTOCOL_VIOLATION") << "no plan was announced yet";
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 10, 4));
  const auto refused = [](const Status& status) { return status.code() == Code::internal; };
  EXPECT_TRUE(refused(timeline.announce_plan(1, 8)));
  EXPECT_TRUE(refused(timeline.announce_plan(2, 3)));
  EXPECT_TRUE(refused(add(timeline, 2, 10, 1, 4)));
  EXPECT_TRUE(refused(add(timeline, 1, 11, 1, 4)));
  EXPECT_TRUE(refused(add(timeline, 1, 9, 1, 4)));
  EXPECT_TRUE(refused(add(timeline, 1, 10, 1, 3)));
  const std::vector<float> rows = numbered_rows(1, 10, 1, 3);
  RowSpan wide(rows);
  EXPECT_TRUE(refused(timeline.add_chunk({1, 10, 1, 4}, wide)));
  RowSpan none(Span<const float>{});
  EXPECT_TRUE(refused(timeline.add_chunk({1, 10, 0, 4}, none)));
  EXPECT_EQ(timeline.buffered_to(), 10U);
  EXPECT_EQ(timeline.committed_to(), 4U);
  EXPECT_EQ(timeline.plan(), 1U);
}

TEST(Timeline, LastPoseIsHeldAndUnderrunsCountedUntilFramesCome) {
  Timeline timeline = small_timeline();
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 2));
  timeline.advance(0.0);
  EXPECT_EQ(timeline.advance(0.05).size(), 1U);
  EXPECT_EQ(timeline.advance(0.2).size(), 0U);
  EXPECT_EQ(timeline.playhead(), 1U);
  EXPECT_EQ(timeline.underruns(), 3U);
  ASSERT_TRUE(add(timeline, 1, 2, 5));
  EXPECT_EQ(timeline.advance(0.21).size(), 1U);
  EXPECT_EQ(timeline.underruns(), 3U);
  EXPECT_EQ(timeline.advance(0.25).size(), 0U);
  EXPECT_EQ(timeline.advance(0.26).size(), 1U);
}

TEST(Timeline, OnlyKeepFramesAreKeptBehindThePlayhead) {
  Timeline timeline = small_timeline(2);
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 10));
  ASSERT_TRUE(timeline.advance_to(7));
  EXPECT_EQ(timeline.first_kept(), 5U);
  EXPECT_FALSE(timeline.row(4));
  EXPECT_EQ(first_number(timeline, 5), 1005);
  EXPECT_EQ(timeline.advance_to(6).status().code(), Code::out_of_range);
  EXPECT_EQ(timeline.advance_to(10).status().code(), Code::out_of_range);
}

TEST(Timeline, FramesJustReachedAreReadableHoweverFewAreKept) {
  Timeline timeline = small_timeline(0);
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  ASSERT_TRUE(add(timeline, 1, 0, 20));
  static_cast<void>(timeline.advance(0));
  const FrameRange reached = timeline.advance(0.25);  // five frame times later
  EXPECT_EQ(reached.first, 1U);
  EXPECT_EQ(reached.end, 6U);
  EXPECT_EQ(timeline.first_kept(), 1U);
  static_cast<void>(timeline.advance(0.3));
  EXPECT_EQ(timeline.first_kept(), 6U);
}

TEST(Timeline, SamplesAreInterpolatedAndStandStillWhilePaused) {
  const Rig rig = chain_rig();
  TimelineOptions options;
  options.row_width = rig.row_width;
  Timeline timeline = std::move(Timeline::make(options)).value();
  std::vector<float> rows;
  for (int frame = 0; frame < 3; ++frame) {
    const std::vector<float> row = chain_row(rig, static_cast<float>(frame));
    rows.insert(rows.end(), row.begin(), row.end());
  }
  std::vector<float> out(rig.row_width, -1.0F);
  EXPECT_FALSE(timeline.sample(0.0, rig, out));
  EXPECT_EQ(out[0], -1.0F);
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  RowSpan source(rows);
  ASSERT_TRUE(timeline.add_chunk({1, 0, 3, 0}, source));
  const auto x_at = [&](double now_s) {
    EXPECT_TRUE(timeline.sample(now_s, rig, out));
    return out[0];
  };
  EXPECT_NEAR(x_at(1.0), 0.0, 1e-5);
  EXPECT_NEAR(x_at(1.0125), 0.25, 1e-5);
  timeline.pause();
  EXPECT_NEAR(x_at(1.5), 0.25, 1e-5);
  timeline.resume();
  EXPECT_NEAR(x_at(2.0), 0.25, 1e-5);
  EXPECT_NEAR(x_at(2.0250), 0.75, 1e-5);
  EXPECT_NEAR(x_at(2.0500), 1.25, 1e-5);
  EXPECT_NEAR(x_at(9.0), 2.0, 1e-5);  // the last one is held
}

TEST(Timeline, ReplanFadesInFromThePoseShown) {
  Walk walk(0.1);
  walk.plan(1, 0, 0);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5);
  walk.plan(2, 1, 11);  // instead of 1 the next frame is at 11
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5) << "the new pose is at 5.5, a gap of 5";
  EXPECT_NEAR(walk.x_at(0.075), 11.5 - 2.5, 1e-4) << "half of the gap after half of blend_s";
  EXPECT_NEAR(walk.x_at(0.126), 12.52, 1e-4);
  EXPECT_EQ(walk.timeline().late_plans(), 0U);
}

TEST(Timeline, TimeScaleSetsThePaceAndExtremeOnesAreRefused) {
  Walk walk(0);
  walk.plan(1, 0, 0);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  ASSERT_TRUE(walk.timeline().set_time_scale(0.5));
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5) << "it holds from this call on";
  EXPECT_NEAR(walk.x_at(0.075), 1.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.125), 1.5, 1e-5);
  EXPECT_EQ(walk.timeline().set_time_scale(0).code(), Code::invalid_argument);
  EXPECT_EQ(walk.timeline().set_time_scale(1e308).code(), Code::invalid_argument) << "infinitely many frames a second";
  EXPECT_EQ(walk.timeline().set_time_scale(5e-324).code(), Code::invalid_argument) << "frames that last for ever";
}

TEST(Timeline, PaceThatIsSetAllTheTimeDoesNotStopTheClock) {
  Walk walk(0);
  walk.plan(1, 0, 0);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  for (int tick = 1; tick <= 14; ++tick) {  // at 100 Hz, twice as fast in every other tick
    ASSERT_TRUE(walk.timeline().set_time_scale(tick % 2 == 0 ? 0.5 : 1.0));
    walk.timeline().advance(0.01 * tick);
  }
  EXPECT_NEAR(walk.x_at(0.15), 8 * 0.2 + 7 * 0.1, 1e-4) << "in ticks of 10 ms, at 20 frames a second";
}

TEST(Timeline, TimeThatIsNotFiniteMovesNothing) {
  Walk walk(0.1);
  const double wrong[] = {std::nan(""), HUGE_VAL, -HUGE_VAL};
  walk.plan(1, 0, 0);
  for (const double now_s : wrong) EXPECT_EQ(walk.timeline().advance(now_s).size(), 0U);
  EXPECT_FALSE(walk.timeline().started());
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5);
  walk.plan(2, 1, 11);  // a jump, which is faded out
  for (const double now_s : wrong) EXPECT_NEAR(walk.x_at(now_s), 0.5, 1e-5);
  EXPECT_EQ(walk.timeline().playhead(), 0U);
  EXPECT_EQ(walk.timeline().underruns(), 0U);
  EXPECT_NEAR(walk.x_at(0.06), 11.2 - 5 * 0.71825, 1e-3) << "the fade goes on";
}

TEST(Timeline, NewSessionContinuesAfterTheHeldFrames) {
  Timeline timeline = small_timeline();
  ASSERT_TRUE(timeline.announce_plan(7, 0));
  ASSERT_TRUE(add(timeline, 7, 0, 10, 4));
  timeline.continue_with_new_plans();
  ASSERT_TRUE(timeline.announce_plan(1, 10));
  ASSERT_TRUE(add(timeline, 1, 10, 5, 12));
  EXPECT_EQ(first_number(timeline, 9), 7009);
  EXPECT_EQ(first_number(timeline, 10), 1010);
}

// A source of a number of bytes, which are never taken.
class Nothing final : public RowSource {
 public:
  explicit Nothing(std::size_t bytes) : bytes_(bytes) {}
  std::size_t num_bytes() const override { return bytes_; }
  void take(std::size_t, void*) override { ADD_FAILURE() << "it must be refused before it is read"; }

 private:
  std::size_t bytes_;
};

TEST(Timeline, FramesBeyondTheLookAheadMemoryAreAProtocolViolation) {
  Timeline timeline = small_timeline();
  ASSERT_TRUE(timeline.announce_plan(1, 0, false));
  const std::uint32_t most = Timeline::kMostAheadBytes / 8;
  Nothing rows(8 * (std::size_t{most} + 1));
  EXPECT_EQ(timeline.add_chunk({1, 0, most + 1, 0}, rows).reason(), "PROTOCOL_VIOLATION");
  EXPECT_TRUE(add(timeline, 1, 0, 4));
}

TEST(Timeline, FramesBeyondTheLastFrameAreAProtocolViolation) {
  TimelineOptions options;
  options.row_width = 2;
  options.start_frame = kLastFrame - 4;
  auto made = Timeline::make(options);
  ASSERT_TRUE(made);
  Timeline timeline = std::move(made).value();
  EXPECT_EQ(timeline.announce_plan(1, kLastFrame + 1, false).reason(), "PROTOCOL_VIOLATION");
  ASSERT_TRUE(timeline.announce_plan(1, kLastFrame - 4, false));
  EXPECT_EQ(add(timeline, 1, kLastFrame - 4, 1, kLastFrame + 1).reason(), "PROTOCOL_VIOLATION");
  EXPECT_EQ(add(timeline, 1, kLastFrame - 4, 5, kLastFrame).reason(), "PROTOCOL_VIOLATION");
  EXPECT_TRUE(add(timeline, 1, kLastFrame - 4, 4, kLastFrame - 4));
  options.start_frame = kLastFrame + 1;
  EXPECT_EQ(Timeline::make(options).status().code(), Code::invalid_argument);
}

TEST(Timeline, MoreThan64CutsAheadAreAProtocolViolation) {
  Timeline timeline = small_timeline();
  for (std::uint32_t plan = 1; plan <= 64; ++plan) ASSERT_TRUE(timeline.announce_plan(plan, 100 + plan, true));
  EXPECT_EQ(timeline.announce_plan(65, 1000, true).reason(), "PROTOCOL_VIOLATION");
  EXPECT_TRUE(timeline.announce_plan(65, 110, true)) << "it replaces those behind it";
  EXPECT_TRUE(timeline.is_cut(109));
  EXPECT_FALSE(timeline.is_cut(111));
  EXPECT_EQ(timeline.cut_before(110), 109U);
  EXPECT_EQ(timeline.cut_before(101), std::nullopt);
}

TEST(Timeline, InvalidOptionsAreRefused) {
  TimelineOptions options;
  EXPECT_EQ(Timeline::make(options).status().code(), Code::invalid_argument);
  options.row_width = 1;
  options.frame_rate_hz = 0;
  EXPECT_EQ(Timeline::make(options).status().code(), Code::invalid_argument);
  options.frame_rate_hz = 20;
  options.keep_frames = 0xFFFFFFFE;
  EXPECT_EQ(Timeline::make(options).status().code(), Code::invalid_argument);
}

}  // namespace
}  // namespace motiongen
