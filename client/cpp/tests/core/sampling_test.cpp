// What is shown of eventful sessions, compared with what the Python client shows.
#include <gtest/gtest.h>

#include <optional>

#include "core/golden.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {
namespace {

Timeline new_timeline(const Rig& rig) {
  TimelineOptions options;
  options.row_width = rig.row_width;
  options.keep_frames = TimelineOptions::kKeepAll;
  return std::move(Timeline::make(options)).value();
}

void tell(const testing::GoldenLine& line, Timeline& timeline) {
  if (line.name == "plan") {
    const auto plan = static_cast<std::uint32_t>(line.number(0));
    EXPECT_TRUE(timeline.announce_plan(plan, static_cast<std::uint64_t>(line.number(1)), line.number(2) != 0));
  } else if (line.name == "chunk") {
    const std::vector<float> rows = line.numbers(3);
    RowSpan source(rows);
    const ChunkHeader header = {static_cast<std::uint32_t>(line.number(0)), static_cast<std::uint64_t>(line.number(1)),
                                static_cast<std::uint32_t>(line.number(2)), 0};
    EXPECT_TRUE(timeline.add_chunk(header, source));
  } else if (line.name == "cut") {
    timeline.note_cut(static_cast<std::uint64_t>(line.number(0)));
  } else if (line.name == "pause") {
    timeline.pause();
  } else if (line.name == "resume") {
    timeline.resume();
  } else if (line.name == "scale") {
    EXPECT_TRUE(timeline.set_time_scale(line.number(0)));
  }
}

TEST(Sampling, PosesEqualThoseOfThePythonClient) {
  const Rig rig = testing::golden_rig();
  std::optional<Timeline> timeline;
  std::vector<float> row(rig.row_width);
  std::size_t num_samples = 0;
  std::size_t number = 0;
  for (const auto& line : testing::read_golden("sampling")) {
    const std::string what = "line " + std::to_string(++number);
    if (line.name == "begin") {
      timeline.emplace(new_timeline(rig));
    } else if (line.name != "sample") {
      tell(line, *timeline);
    } else if (!timeline->sample(line.number(0), rig, row)) {
      EXPECT_EQ(line.expected, std::vector<float>{-1}) << what;
    } else {
      ++num_samples;
      ASSERT_EQ(static_cast<float>(timeline->playhead()), line.expected[0]) << what;
      testing::expect_near(row, {line.expected.data() + 1, line.expected.size() - 1}, what);
    }
  }
  EXPECT_GT(num_samples, 150U);
}

}  // namespace
}  // namespace motiongen
