#include "motiongen/core/steering.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "core/golden.hpp"

namespace motiongen {
namespace {

TEST(Steering, EqualsThatOfThePythonClient) {
  const auto lines = testing::read_golden("steering");
  ASSERT_GT(lines.size(), 30U);
  for (const auto& line : lines) {
    const std::vector<float> given = line.numbers(0);
    if (line.name == "stick") {
      const auto made = stick_velocity(given[0], given[1], {given[2], given[3], given[4]});
      ASSERT_TRUE(made);
      const float values[] = {made.value().x, made.value().z};
      testing::expect_near({values, 2}, line.expected, line.name);
    } else if (line.name == "camera") {
      const GroundVector made = camera_relative(given[0], given[1], given[2]);
      const float values[] = {made.x, made.z};
      testing::expect_near({values, 2}, line.expected, line.name);
    } else {
      const auto made = drawn_corners({given.data() + 1, given.size() - 1}, given[0]);
      ASSERT_TRUE(made);
      testing::expect_near(made.value(), line.expected, line.name);
    }
  }
}

TEST(Steering, InvalidStickValuesAndPointsAreRefused) {
  EXPECT_EQ(stick_velocity(std::numeric_limits<float>::quiet_NaN(), 0).status().code(), Code::invalid_argument);
  EXPECT_EQ(stick_velocity(1, 0, {0, 1, 1}).status().code(), Code::invalid_argument);
  const std::vector<float> points = {0, 0, 1};
  EXPECT_EQ(drawn_corners(points).status().code(), Code::invalid_argument);
  EXPECT_EQ(drawn_corners({points.data(), 2}, 0).status().code(), Code::invalid_argument);
}

}  // namespace
}  // namespace motiongen
