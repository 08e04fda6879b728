#include "motiongen/core/retarget.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

#include "core/golden.hpp"

namespace motiongen {
namespace {

void take_joint(const testing::GoldenLine& line, UserSkeleton& body) {
  body.joint_names.push_back(line.words[0]);
  body.parents.push_back(static_cast<std::int32_t>(line.number(1)));
  const std::vector<float> numbers = line.numbers(2);
  body.offsets.insert(body.offsets.end(), numbers.begin(), numbers.begin() + 3);
  body.rest_wxyz.insert(body.rest_wxyz.end(), numbers.begin() + 3, numbers.end());
}

void take_map(const testing::GoldenLine& line, JointMap& map) {
  if (line.name == "map") {
    const std::vector<float> numbers = line.numbers(0);
    map.metres_per_unit = numbers[0];
    map.scale = numbers[1];
    map.on_feet = numbers[2] != 0;
    map.ground_theirs = numbers[3];
    map.ground_ours_m = numbers[4];
  } else if (line.name == "drive") {
    const std::vector<float> numbers = line.numbers(3);
    map.drives.push_back({line.words[0], line.words[1], line.words[2], numbers[0], {}});
    std::copy(numbers.begin() + 1, numbers.end(), map.drives.back().axes_wxyz.begin());
  } else if (line.name == "chain_theirs") {
    map.chains_theirs.push_back(line.words);
  } else if (line.name == "chain_ours") {
    map.chains_ours.push_back(line.words);
  } else if (line.name == "root_theirs") {
    map.root_theirs = line.words;
  } else if (line.name == "root_ours") {
    map.root_ours = line.words;
  } else if (line.name == "feet") {
    map.feet_ours = line.words;
  }
}

TEST(Retarget, EqualsThatOfThePythonClient) {
  const Rig rig = testing::golden_rig();
  UserSkeleton body;
  JointMap map;
  std::optional<Retargeter> retargeter;
  std::size_t num_frames = 0;
  for (const auto& line : testing::read_golden("retarget")) {
    if (line.name == "joint") {
      if (retargeter) body = {}, map = {}, retargeter.reset();  // the next body begins
      take_joint(line, body);
    } else if (line.name == "begin") {
      auto made = Retargeter::make(rig, body, map);
      ASSERT_TRUE(made) << made.status().message();
      retargeter.emplace(std::move(made).value());
      EXPECT_NEAR(retargeter->scale(), line.expected[0], 1e-5);
    } else if (line.name == "frame") {
      ++num_frames;
      std::vector<float> made(3 + 4 * body.joint_names.size());
      retargeter->apply(line.numbers(0), {made.data(), 3}, {made.data() + 3, made.size() - 3});
      for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(made[axis], line.expected[axis], 1e-2) << num_frames;
      testing::expect_near({made.data() + 3, made.size() - 3}, {line.expected.data() + 3, line.expected.size() - 3},
                           "frame " + std::to_string(num_frames));
    } else {
      take_map(line, map);
    }
  }
  EXPECT_EQ(num_frames, 12U);
}

TEST(Retarget, IncompleteSkeletonOrMapIsRefusedAndJointsAreNamed) {
  const Rig rig = testing::golden_rig();
  UserSkeleton body;
  JointMap map;
  EXPECT_EQ(Retargeter::make(rig, body, map).status().code(), Code::invalid_argument);
  body.joint_names = {"base"};
  body.parents = {-1};
  body.offsets = {0, 0, 0};
  map.root_theirs = {"base"};
  map.root_ours = {"root"};
  EXPECT_EQ(Retargeter::make(rig, body, map).status().code(), Code::invalid_argument) << "no scale and no chains";
  map.scale = 1;
  EXPECT_TRUE(Retargeter::make(rig, body, map));
  Drive drive;
  drive.theirs = "base";
  drive.ours = "nose";
  map.drives = {drive};
  const auto refused = Retargeter::make(rig, body, map);
  EXPECT_EQ(refused.status().code(), Code::not_found);
  EXPECT_NE(refused.status().message().find("middle"), std::string::npos);
}

// A body of two joints that follows two of ours.
struct Body {
  UserSkeleton skeleton;
  JointMap map;

  Body() {
    skeleton.joint_names = {"base", "tip"};
    skeleton.parents = {-1, 0};
    skeleton.offsets = {0, 0, 0, 0, 1, 0};
    skeleton.rest_wxyz = {1, 0, 0, 0, 1, 0, 0, 0};
    Drive drive;
    drive.theirs = "base";
    drive.ours = "root";
    map.drives = {drive};
    map.root_theirs = {"base"};
    map.root_ours = {"root"};
    map.chains_theirs = {{"base", "tip"}};
    map.chains_ours = {{"root", "middle"}};
  }

  Code made() const { return Retargeter::make(testing::golden_rig(), skeleton, map).status().code(); }
};

TEST(Retarget, InvalidNumbersAndChainsAreRefused) {
  EXPECT_EQ(Body().made(), Code::ok);
  using Spoil = void (*)(Body&);
  const Spoil spoilt[] = {
      [](Body& body) { body.map.chains_theirs = {{"tip"}}; },  // no bone: the scale would be infinite
      [](Body& body) { body.map.chains_ours = {{"root"}}; },
      [](Body& body) { body.skeleton.offsets[4] = NAN; },
      [](Body& body) { body.skeleton.rest_wxyz[0] = 2; },
      [](Body& body) { body.skeleton.rest_wxyz[5] = NAN; },
      [](Body& body) { body.skeleton.joint_names[1] = "base"; },
      [](Body& body) { body.map.metres_per_unit = HUGE_VALF; },
      [](Body& body) { body.map.scale = HUGE_VALF; },
      [](Body& body) { body.map.scale = NAN; },
      [](Body& body) { body.map.ground_theirs = NAN; },
      [](Body& body) { body.map.ground_ours_m = HUGE_VALF; },
      [](Body& body) { body.map.drives[0].fraction = 1.5F; },
      [](Body& body) { body.map.drives[0].fraction = NAN; },
      [](Body& body) {
        body.map.drives[0].axes_wxyz = {0, 0, 0, 0};
      },
  };
  for (std::size_t number = 0; number < std::size(spoilt); ++number) {
    Body body;
    spoilt[number](body);
    EXPECT_EQ(body.made(), Code::invalid_argument) << number;
  }
}

}  // namespace
}  // namespace motiongen
