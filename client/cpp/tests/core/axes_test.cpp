#include "motiongen/core/axes.hpp"

#include <gtest/gtest.h>

#include "core/golden.hpp"

namespace motiongen {
namespace {

const Axes& axes_called(const std::string& name) {
  return name == "Unreal" ? kUnreal : name == "Unity" ? kUnity : name == "Godot" ? kGodot : kRos;
}

TEST(Axes, EqualThoseOfThePythonClient) {
  const auto lines = testing::read_golden("axes");
  ASSERT_EQ(lines.size(), 16U);
  for (const auto& line : lines) {
    const std::vector<float> given = line.numbers(0);
    std::vector<float> made(7);
    axes_called(line.name).positions({given.data(), 3}, {made.data(), 3});
    axes_called(line.name).quaternions_xyzw({given.data() + 3, 4}, {made.data() + 3, 4});
    for (std::size_t place = 0; place < 3; ++place) EXPECT_NEAR(made[place], line.expected[place], 1e-3) << line.name;
    testing::expect_near({made.data() + 3, 4}, {line.expected.data() + 3, 4}, line.name);
  }
}

TEST(Axes, PositionsMayBeConvertedInPlace) {
  std::vector<float> place = {1, 2, 3};  // to the left, up, ahead
  kUnreal.positions(place, place);
  EXPECT_EQ(place, (std::vector<float>{300, -100, 200}));
  EXPECT_TRUE(kUnity.is_left_handed());
  EXPECT_FALSE(kGodot.is_left_handed());
}

}  // namespace
}  // namespace motiongen
