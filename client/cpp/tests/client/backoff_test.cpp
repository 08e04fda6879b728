#include "client/backoff.hpp"

#include <gtest/gtest.h>

#include "client/timeouts.hpp"

namespace motiongen {
namespace {

TEST(Backoff, GrowsWhileCallsLastNoLongerThanOnePing) {
  Backoff backoff;
  double now_s = 100;
  double before_s = 0;
  for (int call = 0; call < 30; ++call) {
    backoff.begin_call();
    backoff.note_pong();  // the call lasted this long at most
    const double wait_s = backoff.next_s(now_s);
    EXPECT_GE(wait_s, before_s);
    EXPECT_LE(wait_s, now_s - 100 < Backoff::kSoonS ? Backoff::kMostSoonS : Backoff::kMostS);
    before_s = wait_s;
    now_s += wait_s;
  }
  EXPECT_EQ(before_s, Backoff::kMostS);
}

TEST(Backoff, StartsAgainAfterACallThatAnsweredTwoPings) {
  Backoff backoff;
  for (int call = 0; call < 30; ++call) static_cast<void>(backoff.next_s(100 + call));
  backoff.begin_call();
  backoff.note_pong();
  backoff.note_pong();
  EXPECT_EQ(backoff.next_s(200), Backoff::kFirstS);
  EXPECT_GT(backoff.next_s(200), Backoff::kFirstS) << "the next call has not answered two pings";
  for (int call = 0; call < 30; ++call) EXPECT_LE(backoff.next_s(202), Backoff::kMostSoonS);
}

TEST(Backoff, StartsAgainAfterASessionThatGotFrames) {
  Backoff backoff;
  for (int time = 0; time < 30; ++time) static_cast<void>(backoff.next_s(100 + time));
  EXPECT_EQ(backoff.next_s(130), Backoff::kMostS);
  backoff.note_frames();
  EXPECT_EQ(backoff.next_s(200), Backoff::kFirstS);
  EXPECT_GT(backoff.next_s(200), Backoff::kFirstS);
}

TEST(Backoff, DelayAskedForByAServerIsBoundedToAnHour) {
  EXPECT_EQ(Backoff::bounded_s(7.5), 7.5);
  EXPECT_EQ(Backoff::bounded_s(-7.5), 0);
  EXPECT_EQ(Backoff::bounded_s(1e18), 3600);
}

TEST(Timeouts, AreBoundedToWhatAClockCanCount) {
  EXPECT_EQ(bounded_s(HUGE_VAL), kLongestS);
  EXPECT_EQ(bounded_s(1e300), kLongestS);
  EXPECT_EQ(bounded_s(-1), 0);
  EXPECT_EQ(bounded_s(2.5), 2.5);
  EXPECT_TRUE(check_timeout(HUGE_VAL));
  EXPECT_EQ(check_timeout(std::nan("")).code(), Code::invalid_argument);
}

}  // namespace
}  // namespace motiongen
