#include "motiongen/core/rig.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/rows.hpp"

namespace motiongen {
namespace {

using testing::chain_rig;

TEST(Rig, KnownBlocksAreFoundBesideUnknownOnes) {
  const Rig rig = chain_rig();
  EXPECT_EQ(rig.row_width, 21U);
  EXPECT_EQ(rig.root_column, 0U);
  EXPECT_EQ(rig.rotation_column, 5U);
  EXPECT_EQ(rig.contact_column, 17U);
}

TEST(Rig, UnknownJointErrorListsTheKnownJoints) {
  const Rig rig = chain_rig();
  EXPECT_EQ(rig.joint("Head").value(), 2U);
  const auto missing = rig.joint("Tail");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.status().code(), Code::not_found);
  EXPECT_NE(missing.status().message().find("Hips, Spine, Head"), std::string::npos);
}

TEST(Rig, InconsistentRigsAreRefused) {
  const auto broken = [](auto change) {
    Rig rig = chain_rig();
    change(rig);
    return rig.check().code() == Code::internal;
  };
  EXPECT_TRUE(broken([](Rig& rig) { rig.parents.pop_back(); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.offsets_m.push_back(0); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.parents[1] = 2; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.parents[0] = 0; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.frame_rate_hz = 0; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.hip_joints = {1}; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.hip_joints = {1, 3}; })) << "it would be read past the end of a row";
  EXPECT_FALSE(broken([](Rig& rig) { rig.hip_joints = {1, 2}; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.limbs = {{"LeftFoot", {2, 0xFFFFFFFF}}}; }));
  EXPECT_FALSE(broken([](Rig& rig) { rig.limbs = {{"LeftFoot", {1, 2}}}; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.blocks[2].width = 11; }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.blocks.pop_back(); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.blocks.push_back({"huge", 0xFFFFFFFF}); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.blocks.push_back({"wide", 1 << 14}); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.joint_names.clear(); }));
  EXPECT_TRUE(broken([](Rig& rig) { rig.offsets_m[4] = HUGE_VALF; }));
  EXPECT_FALSE(broken([](Rig&) {}));
}

TEST(Rig, OutputsOfAWrongWidthAreRefused) {
  const auto checked = [](const char* name, std::uint32_t width) {
    Rig rig = chain_rig();
    rig.outputs = {{name, width}};
    return rig.check().code();
  };
  EXPECT_EQ(checked("g1_qpos", 36), Code::ok);
  EXPECT_EQ(checked("g1_qpos", 1), Code::internal);
  EXPECT_EQ(checked("joint_positions_m", 9), Code::ok);
  EXPECT_EQ(checked("joint_positions_m", 10), Code::internal);
  EXPECT_EQ(checked("joint_global_rotation_quat_wxyz", 11), Code::internal);
  EXPECT_EQ(checked("of_a_later_version", 1), Code::ok);
}

}  // namespace
}  // namespace motiongen
