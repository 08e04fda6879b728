// A timeline of a chain that walks straight ahead, for tests of the poses that are shown.
#pragma once

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "core/rows.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen::testing {

// Frames of a chain whose root moves along x, a metre a frame from `x_m` on.
inline std::vector<float> walk(const Rig& rig, std::uint32_t num_frames, float x_m) {
  std::vector<float> rows;
  for (std::uint32_t frame = 0; frame < num_frames; ++frame) {
    const std::vector<float> row = chain_row(rig, x_m + static_cast<float>(frame));
    rows.insert(rows.end(), row.begin(), row.end());
  }
  return rows;
}

// A timeline with plans of five such frames each, which is sampled.
class Walk {
 public:
  explicit Walk(double blend_s) : rig_(chain_rig()), out_(rig_.row_width), timeline_(make(rig_, blend_s)) {}
  void plan(std::uint32_t number, std::uint64_t from, float x_m, bool is_cut = false) {
    ASSERT_TRUE(timeline_.announce_plan(number, from, is_cut));
    rows(number, from, x_m);
  }
  void rows(std::uint32_t number, std::uint64_t from, float x_m) {
    const std::vector<float> rows = walk(rig_, 5, x_m);
    RowSpan source(rows);
    ASSERT_TRUE(timeline_.add_chunk({number, from, 5, 0}, source));
  }
  float x_at(double now_s) {
    EXPECT_TRUE(timeline_.sample(now_s, rig_, out_));
    return out_[0];
  }
  Timeline& timeline() { return timeline_; }

 private:
  static Timeline make(const Rig& rig, double blend_s) {
    TimelineOptions options;
    options.row_width = rig.row_width;
    options.blend_s = blend_s;
    return std::move(Timeline::make(options)).value();
  }
  Rig rig_;
  std::vector<float> out_;
  Timeline timeline_;
};

}  // namespace motiongen::testing
