// Nothing is allocated while motion plays, however long: a game's frame must not wait for an allocator.
#include <gtest/gtest.h>

#include "core/counting_allocator.hpp"
#include "core/rows.hpp"
#include "motiongen/core/pose.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {
namespace {

using testing::chain_rig;
using testing::num_allocations;

TEST(TimelineAllocation, TenMinutesOfPlaybackAllocateNoMemory) {
  constexpr std::uint32_t kChunk = 4;
  constexpr std::uint32_t kAhead = 40;
  const Rig rig = chain_rig();
  TimelineOptions options;
  options.row_width = rig.row_width;
  options.keep_frames = 20;
  options.reserve_frames = kAhead + kChunk;
  Timeline timeline = std::move(Timeline::make(options)).value();
  const std::vector<float> rows(kChunk * rig.row_width, 0.5F);
  std::vector<float> out(rig.row_width);
  std::vector<float> positions(3 * rig.num_joints());
  std::uint32_t plan = 0;
  std::uint64_t received = 0;
  const std::uint64_t before = num_allocations();
  for (int tick = 0; tick < 60 * 600; ++tick) {  // 60 times a second
    const double now_s = tick / 60.0;
    if (tick % 120 == 0) {  // a replan
      if (received > timeline.playhead() + 8) received = timeline.playhead() + 8;
      if (!timeline.announce_plan(++plan, received)) FAIL();
    }
    while (received + kChunk <= timeline.playhead() + kAhead) {
      RowSpan source(rows);
      if (!timeline.add_chunk({plan, received, kChunk, timeline.playhead()}, source)) FAIL();
      received += kChunk;
    }
    timeline.sample(now_s, rig, out);
    joint_positions(rig, out, positions);
  }
  EXPECT_EQ(num_allocations(), before);
  EXPECT_GT(timeline.playhead(), 11'900U);
  EXPECT_EQ(timeline.underruns(), 0U);
}

}  // namespace
}  // namespace motiongen
