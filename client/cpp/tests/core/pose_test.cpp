#include "motiongen/core/pose.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/rows.hpp"

namespace motiongen {
namespace {

using testing::chain_rig;
using testing::chain_row;

constexpr float kHalfTurn = 3.14159265F;

void turn_about_x(const Rig& rig, std::vector<float>& row, std::uint32_t joint, float angle, float sign = 1) {
  row[rig.rotation_column + 4 * joint] = sign * std::cos(angle / 2);
  row[rig.rotation_column + 4 * joint + 1] = sign * std::sin(angle / 2);
}

TEST(Pose, JointsFollowTheirParents) {
  const Rig rig = chain_rig();
  std::vector<float> row = chain_row(rig, 5);
  turn_about_x(rig, row, 1, kHalfTurn / 2);  // +Y becomes +Z above the spine
  std::vector<float> positions(9);
  joint_positions(rig, row, positions);
  const std::vector<float> expected = {5, 0, 0, 5, 1, 0, 5, 1, 1};
  for (std::size_t index = 0; index < 9; ++index) EXPECT_NEAR(positions[index], expected[index], 1e-6);
}

TEST(Pose, RotationsAreAccumulatedFromTheRoot) {
  const Rig rig = chain_rig();
  std::vector<float> row = chain_row(rig, 0);
  turn_about_x(rig, row, 0, 0.4F);
  turn_about_x(rig, row, 1, 0.6F);
  std::vector<float> positions(9);
  std::vector<float> rotations(12);
  joint_transforms(rig, row, positions, rotations);
  EXPECT_NEAR(rotations[8], std::cos(0.5F), 1e-6);
  EXPECT_NEAR(rotations[9], std::sin(0.5F), 1e-6);
}

TEST(Pose, InterpolationTurnsEvenlyAndTheShorterWay) {
  const Rig rig = chain_rig();
  const std::vector<float> from = chain_row(rig, 0);
  std::vector<float> to = chain_row(rig, 4);
  turn_about_x(rig, to, 1, 1.2F, -1);  // the same rotation with the other sign
  to[rig.contact_column] = 1;
  to[3] = 8;  // of a block this library does not know
  std::vector<float> out(rig.row_width);
  interpolate(rig, from, to, 0.25F, out);
  EXPECT_NEAR(out[rig.root_column], 1, 1e-6);
  EXPECT_NEAR(out[3], 2, 1e-6);
  EXPECT_NEAR(std::abs(out[rig.rotation_column + 5]), std::sin(0.15F), 1e-6);
  EXPECT_NEAR(std::abs(out[rig.rotation_column + 4]), std::cos(0.15F), 1e-6);
  EXPECT_EQ(out[rig.contact_column], 0);
  interpolate(rig, from, to, 0.75F, out);
  EXPECT_EQ(out[rig.contact_column], 1);
}

TEST(Pose, InterpolationOfNearlyEqualRotationsHasUnitLength) {
  const Rig rig = chain_rig();
  const std::vector<float> from = chain_row(rig, 0);
  std::vector<float> to = chain_row(rig, 0);
  turn_about_x(rig, to, 2, 0.01F);
  std::vector<float> out(rig.row_width);
  interpolate(rig, from, to, 0.5F, out);
  const float* q = &out[rig.rotation_column + 8];
  EXPECT_NEAR(q[0] * q[0] + q[1] * q[1], 1, 1e-6);
  EXPECT_NEAR(q[1], std::sin(0.0025F), 1e-6);
}

TEST(Pose, InterpolationEndsAtTheFramesThemselves) {
  const Rig rig = chain_rig();
  const std::vector<float> from = chain_row(rig, 1);
  std::vector<float> to = chain_row(rig, 2);
  turn_about_x(rig, to, 0, 2.0F);
  std::vector<float> out(rig.row_width);
  interpolate(rig, from, to, 0, out);
  EXPECT_EQ(out, from);
  interpolate(rig, from, to, 1, out);
  for (std::size_t column = 0; column < out.size(); ++column) EXPECT_NEAR(out[column], to[column], 1e-6);
}

}  // namespace
}  // namespace motiongen
