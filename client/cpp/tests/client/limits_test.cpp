// Edits that the client refuses, since a server could only end the stream because of them, and waits with their
// timeouts.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "live_server.hpp"
#include "motiongen/client/client.hpp"

namespace motiongen {
namespace {

TEST(Limits, SessionTooBigForAMessageIsRefusedAndOthersPlay) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  auto walker = client->open(walking());
  ASSERT_TRUE(walker->wait_open(kLimitS));
  SessionOptions big = walking();
  const std::size_t row = walker->rig().row_width;
  big.prior_rows.resize(row * (client->catalog()->limits.max_request_bytes / (4 * row) + 1));
  const auto refused = client->open(big);
  EXPECT_EQ(refused.status().code(), Code::invalid_argument) << refused.status().message();
  EXPECT_TRUE(walker->wait_frame(10, kLimitS));
  EXPECT_EQ(client->stats().reconnects, 0U);
}

TEST(Limits, InfiniteTimeoutsAreAccepted) {
  ClientOptions options = server();
  options.connect_timeout_s = HUGE_VAL;
  auto client = Client::connect(options);
  ASSERT_TRUE(client) << client.status().message();
  auto walker = client->open(walking());
  EXPECT_TRUE(walker->wait_open(HUGE_VAL));
  EXPECT_TRUE(walker->wait_frame(4, 1e300));
  const auto edit = walker->set_prompt("a person runs");
  ASSERT_TRUE(edit);
  EXPECT_TRUE(walker->wait_edit(edit.value(), HUGE_VAL));
  ClipOptions clip;
  clip.num_frames = 20;
  clip.prompt = "a person walks";
  clip.timeout_s = HUGE_VAL;
  EXPECT_TRUE(client->generate_clip(clip));
  EXPECT_EQ(walker->wait_frame(1000000, -1).code(), Code::deadline_exceeded);
}

TEST(Limits, NanTimeoutsAreRefused) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  auto walker = client->open(walking());
  const double none = std::nan("");
  EXPECT_EQ(walker->wait_open(none).status().code(), Code::invalid_argument);
  EXPECT_EQ(walker->wait_edit(1, none).status().code(), Code::invalid_argument);
  EXPECT_EQ(walker->wait_reached(1, none).status().code(), Code::invalid_argument);
  EXPECT_EQ(walker->wait_frame(0, none).code(), Code::invalid_argument);
  ClipOptions clip;
  clip.num_frames = 20;
  clip.timeout_s = none;
  EXPECT_EQ(client->generate_clip(clip).status().code(), Code::invalid_argument);
  ClientOptions options = server();
  options.connect_timeout_s = none;
  EXPECT_EQ(Client::connect(options).status().code(), Code::invalid_argument);
}

TEST(Limits, FlushIntervalOutOfRangeIsRefused) {
  for (const double wrong : {0.0, 0.004, 0.2, -1.0, std::nan("")}) {
    ClientOptions options = server();
    options.flush_interval_s = wrong;
    EXPECT_EQ(Client::connect(options).status().code(), Code::invalid_argument) << wrong;
  }
}

}  // namespace
}  // namespace motiongen
