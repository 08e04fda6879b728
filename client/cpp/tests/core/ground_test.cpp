// The ground, compared with the Python client's result for the same walk.
#include "motiongen/core/ground.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "core/counting_allocator.hpp"
#include "core/golden.hpp"

namespace motiongen {
namespace {

using Heightfield = double (*)(double, double);

Heightfield heights_called(const std::string& name) {
  if (name == "slope") return [](double x, double z) { return 0.2 * z + 0.1 * x; };
  if (name == "stairs") return [](double, double z) { return -0.12 * std::floor((z + 0.26) / 0.6); };
  if (name == "hills") return [](double x, double z) { return 0.08 * std::sin(1.7 * z) + 0.05 * std::cos(2.1 * x); };
  return [](double, double) { return 0.0; };
}

// The body and the walk of the vectors.
struct Walk {
  Rig rig;
  std::vector<float> rows;
  std::vector<testing::GoldenLine> lines;

  Walk() : lines(testing::read_golden("ground")) {
    rig.rig_id = "walker";
    rig.frame_rate_hz = 20;
    rig.blocks = {{"root_translation_m", 3}, {"joint_rotation_quat_wxyz", 36}, {"foot_contact", 4}};
    rig.limbs = {{"LeftFoot", {3, 4}}, {"RightFoot", {7, 8}}};
    for (const auto& line : lines) {
      if (line.name == "joint") {
        rig.joint_names.push_back(line.words[0]);
        rig.parents.push_back(static_cast<std::int32_t>(line.number(1)));
        const std::vector<float> offset = line.numbers(2);
        rig.offsets_m.insert(rig.offsets_m.end(), offset.begin(), offset.end());
      } else if (line.name == "row") {
        const std::vector<float> row = line.numbers(0);
        rows.insert(rows.end(), row.begin(), row.end());
      }
    }
    EXPECT_TRUE(rig.check());
  }

  Ground on(const std::string& name) const { return std::move(Ground::make(rig, heights_called(name))).value(); }
  std::size_t num_frames() const { return rows.size() / rig.row_width; }
};

Timeline new_timeline(const Rig& rig, std::uint32_t keep_frames) {
  TimelineOptions options;
  options.row_width = rig.row_width;
  options.keep_frames = keep_frames;
  options.reserve_frames = 80;
  return std::move(Timeline::make(options)).value();
}

TEST(Ground, WholeMotionEqualsThatOfThePythonClient) {
  const Walk walk;
  const std::size_t width = walk.rig.row_width;
  std::size_t num_grounds = 0;
  for (const auto& line : walk.lines) {
    if (line.name != "apply") continue;
    ++num_grounds;
    Ground ground = walk.on(line.words[0]);
    std::vector<float> rows = walk.rows;
    ASSERT_TRUE(ground.apply(rows));
    std::size_t at = 0;
    for (std::size_t frame = 0; frame < walk.num_frames(); frame += 7, at += width) {
      testing::expect_near({rows.data() + frame * width, width}, {line.expected.data() + at, width},
                           line.words[0] + ", frame " + std::to_string(frame));
    }
    EXPECT_EQ(at, line.expected.size());
  }
  EXPECT_EQ(num_grounds, 4U);
}

void take_chunk(const testing::GoldenLine& line, const Walk& walk, Timeline& timeline) {
  const std::size_t width = walk.rig.row_width;
  const auto count = static_cast<std::uint32_t>(line.number(2));
  const float* from = walk.rows.data() + static_cast<std::size_t>(line.number(3)) * width;
  std::vector<float> rows(from, from + count * width);
  const auto aside_m = static_cast<float>(line.number(4));
  for (std::uint32_t row = 0; row < count; ++row) rows[row * width] += aside_m * static_cast<float>(row + 1);
  const auto plan = static_cast<std::uint32_t>(line.number(0));
  const auto first = static_cast<std::uint64_t>(line.number(1));
  ASSERT_TRUE(timeline.announce_plan(plan, first, line.number(5) != 0));
  RowSpan source(rows);
  ASSERT_TRUE(timeline.add_chunk({plan, first, count, 0}, source));
}

TEST(Ground, FollowedFramesEqualThoseOfThePythonClient) {
  const Walk walk;
  std::optional<Timeline> timeline;
  std::optional<GroundFollower> follower;
  std::vector<float> row(walk.rig.row_width);
  std::size_t num_samples = 0;
  std::string name;
  for (const auto& line : walk.lines) {
    if (line.name == "begin") {
      name = line.words[0];
      timeline.emplace(new_timeline(walk.rig, TimelineOptions::kKeepAll));
      follower.emplace(walk.on(name));
    } else if (line.name == "chunk") {
      take_chunk(line, walk, *timeline);
    } else if (line.name == "sample") {
      ++num_samples;
      const std::string what = name + " at " + line.words[0];
      ASSERT_TRUE(timeline->sample(line.number(0), walk.rig, row)) << what;
      ASSERT_TRUE(follower->apply(*timeline, row)) << what;
      ASSERT_EQ(static_cast<float>(timeline->playhead()), line.expected[0]) << what;
      std::vector<float> made = {row[1]};
      if (line.expected.size() > 2) {
        for (const std::size_t joint : {1U, 2U, 3U, 5U, 6U, 7U}) {
          made.insert(made.end(), &row[3 + 4 * joint], &row[3 + 4 * joint] + 4);
        }
      }
      testing::expect_near(made, {line.expected.data() + 1, line.expected.size() - 1}, what);
    }
  }
  EXPECT_GT(num_samples, 300U);
}

TEST(Ground, FollowingAllocatesNoMemory) {
  const Walk walk;
  Timeline timeline = new_timeline(walk.rig, 30);
  GroundFollower follower(walk.on("hills"));
  const std::size_t width = walk.rig.row_width;
  constexpr std::uint32_t kChunk = 8;
  std::vector<float> row(width);
  std::uint64_t received = 0;
  std::uint64_t before = 0;
  ASSERT_TRUE(timeline.announce_plan(1, 0));
  for (int tick = 0; tick < 60 * 60; ++tick) {
    while (received < timeline.playhead() + 40) {
      const std::size_t from = received % (walk.num_frames() - kChunk);
      RowSpan source({walk.rows.data() + from * width, kChunk * width});
      if (!timeline.add_chunk({1, received, kChunk, timeline.playhead()}, source)) FAIL();
      received += kChunk;
    }
    timeline.sample(tick / 60.0, walk.rig, row);
    if (!follower.apply(timeline, row)) FAIL();
    if (tick == 600) before = testing::num_allocations();
  }
  EXPECT_EQ(testing::num_allocations(), before);
}

TEST(Ground, InvalidRigsRowsAndHeightsAreRefused) {
  const Walk walk;
  EXPECT_EQ(Ground::make(walk.rig, nullptr).status().code(), Code::invalid_argument);
  EXPECT_EQ(Ground::make(testing::golden_rig(), heights_called("level")).status().code(), Code::not_found);
  Rig odd = walk.rig;
  odd.offsets_m[3 * 3 + 1] = -0.1F;  // a shin much shorter than the thigh
  EXPECT_EQ(Ground::make(odd, heights_called("level")).status().code(), Code::invalid_argument);
  odd.offsets_m.assign(odd.offsets_m.size(), 0);  // legs of no length
  EXPECT_EQ(Ground::make(odd, heights_called("level")).status().code(), Code::invalid_argument);
  Ground ground = walk.on("level");
  std::vector<float> rows = walk.rows;
  rows.pop_back();
  EXPECT_EQ(ground.apply(rows).code(), Code::invalid_argument) << "no whole rows";
  rows = walk.rows;
  Ground endless =
      std::move(Ground::make(walk.rig, [](double, double) { return std::numeric_limits<double>::infinity(); })).value();
  EXPECT_EQ(endless.apply(rows).code(), Code::invalid_argument);
  EXPECT_EQ(rows, walk.rows);
  int num_asked_of_no_place = 0;
  Ground asked = std::move(Ground::make(walk.rig, [&num_asked_of_no_place](double x, double z) {
                   num_asked_of_no_place += std::isfinite(x) && std::isfinite(z) ? 0 : 1;
                   return 0.0;
                 })).value();
  for (const std::size_t axis : {0U, 1U, 2U}) {
    std::vector<float> nowhere = walk.rows;
    nowhere[walk.rig.row_width + axis] = std::numeric_limits<float>::quiet_NaN();
    EXPECT_EQ(asked.apply(nowhere).code(), Code::invalid_argument) << axis;
  }
  EXPECT_EQ(num_asked_of_no_place, 0) << "a heightfield may look places up in a table";
  GroundFollower follower(walk.on("level"));
  const Timeline unbegun = new_timeline(walk.rig, 30);
  EXPECT_EQ(follower.apply(unbegun, rows).code(), Code::failed_precondition);
  const Timeline other = new_timeline(testing::golden_rig(), 30);
  EXPECT_EQ(follower.apply(other, rows).code(), Code::invalid_argument);
}

}  // namespace
}  // namespace motiongen
