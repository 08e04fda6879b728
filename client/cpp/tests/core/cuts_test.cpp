// Cuts: nothing is blended across them, even if they became known late.
#include <gtest/gtest.h>

#include "core/walk.hpp"

namespace motiongen {
namespace {

using testing::Walk;

TEST(Cuts, NothingIsBlendedAtACut) {
  Walk walk(0.1);
  walk.plan(1, 0, 0);
  walk.plan(2, 2, 50, true);
  EXPECT_TRUE(walk.timeline().is_cut(2));
  EXPECT_EQ(walk.timeline().cut_before(3), std::optional<std::uint64_t>(2));
  EXPECT_FALSE(walk.timeline().cut_before(2));
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.09), 1.0, 1e-5) << "the pose stands still until the cut";
  EXPECT_NEAR(walk.x_at(0.105), 50.1, 1e-4);
}

TEST(Cuts, CutAlreadyPassedShowsAtTheNextFrame) {
  for (const bool is_in_plan : {true, false}) {
    Walk walk(0.1);
    walk.plan(1, 0, 0);
    EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
    EXPECT_NEAR(walk.x_at(0.16), 3.2, 1e-5);
    ASSERT_TRUE(walk.timeline().announce_plan(2, 1, is_in_plan));
    EXPECT_EQ(walk.timeline().note_cut(2), 4U);
    EXPECT_EQ(walk.timeline().note_cut(6), 6U) << "ahead, it shows at its own frame";
    walk.rows(2, 1, 50);
    EXPECT_EQ(walk.timeline().cut_before(5), 4U);
    EXPECT_FALSE(walk.timeline().cut_before(4));
    EXPECT_NEAR(walk.x_at(0.205), 53.1, 1e-4);
  }
}

TEST(Cuts, CutAlreadyShownStaysWhenALatePlanBeginsBeforeIt) {
  Walk walk(0.1);
  walk.plan(1, 0, 0);
  walk.plan(2, 2, 50, true);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.155), 51.1, 1e-4);
  ASSERT_TRUE(walk.timeline().announce_plan(3, 1));
  EXPECT_TRUE(walk.timeline().is_cut(2));
}

TEST(Cuts, FadeEndsAtACutBetweenTwoSamples) {
  Walk walk(1.0);
  walk.plan(1, 0, 0);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5);
  walk.plan(2, 1, 11);
  walk.plan(3, 2, 50, true);
  EXPECT_NEAR(walk.x_at(0.025), 0.5, 1e-5) << "a fade has begun";
  EXPECT_NEAR(walk.x_at(0.155), 51.1, 1e-4) << "at 3, with nothing drawn since 0";
}

TEST(Cuts, CutIsKnownUntilItWasSampled) {
  Walk walk(0.1);  // which keeps no frame behind the playhead
  walk.plan(1, 0, 0);
  EXPECT_NEAR(walk.x_at(0.0), 0.0, 1e-5);
  ASSERT_TRUE(walk.timeline().announce_plan(2, 5, true));
  EXPECT_NEAR(walk.x_at(0.21), 4.0, 1e-5);
  walk.rows(2, 5, 50);
  walk.timeline().advance(0.26);  // as for a report; then a plan comes before the next frame is drawn
  ASSERT_TRUE(walk.timeline().announce_plan(3, 10));
  EXPECT_GE(walk.x_at(0.26), 50.0);
}

}  // namespace
}  // namespace motiongen
