// Texts that no message or header may contain, on a real server: only the call that they were given to fails.
#include <gtest/gtest.h>

#include <string>

#include "live_server.hpp"
#include "motiongen/client/client.hpp"

namespace motiongen {
namespace {

constexpr char kLatin1[] = "\xE9";

TEST(WrongTexts, TokenWithALineEndIsRefused) {
  ClientOptions options = server();
  options.token = "abc\n";
  const auto refused = Client::connect(options);
  EXPECT_EQ(refused.status().code(), Code::invalid_argument);
  EXPECT_EQ(refused.status().message().rfind("token: the byte 0x0a at position 3 of 4", 0), 0U)
      << refused.status().message();
}

TEST(WrongTexts, LongAgentNameIsCutBetweenCharactersAndInvalidOneRefused) {
  ClientOptions options = server();
  options.agent = std::string(98, 'x') + "\xC3\xA9";
  const auto client = Client::connect(options);
  EXPECT_TRUE(client) << client.status().message();
  options.agent = kLatin1;
  EXPECT_EQ(Client::connect(options).status().code(), Code::invalid_argument);
}

TEST(WrongTexts, TextThatIsNotUtf8IsRefusedAndOtherSessionsPlay) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  auto told = client->open(walking());
  auto other = client->open(walking());
  ASSERT_TRUE(told->wait_open(kLimitS));
  ASSERT_TRUE(other->wait_open(kLimitS));
  const auto is_refused = [](const Status& status) { return status.code() == Code::invalid_argument; };
  EXPECT_TRUE(is_refused(told->set_prompt(kLatin1).status()));
  std::uint32_t id = 0;
  ASSERT_TRUE(told->schedule_prompt("a person waves", 80, 0, &id));
  EXPECT_TRUE(is_refused(told->schedule_prompt(kLatin1, 80).status()));
  EXPECT_TRUE(is_refused(told->replace_prompt(id, kLatin1, 80).status()));
  EXPECT_TRUE(is_refused(told->set_prompt(Prompt::preset(kLatin1)).status()));
  FootContact foot;
  foot.frame = 60;
  foot.limb = kLatin1;
  const Target target = foot;
  EXPECT_TRUE(is_refused(told->add_targets({&target, 1}).status()));
  SessionOptions options = walking();
  options.model_id = kLatin1;
  EXPECT_TRUE(is_refused(client->open(options).status()));
  ClipOptions clip;
  clip.num_frames = 20;
  clip.prompt = kLatin1;
  EXPECT_TRUE(is_refused(client->generate_clip(clip).status()));
  clip.prompt = Prompt();
  clip.outputs = {kLatin1};
  EXPECT_TRUE(is_refused(client->generate_clip(clip).status()));
  const auto edit = told->set_prompt("a person goes to the caf\xC3\xA9");
  ASSERT_TRUE(edit);
  EXPECT_TRUE(told->wait_edit(edit.value(), kLimitS).value().status);
  for (std::uint64_t frame = 0; frame < 60; ++frame) {
    ASSERT_TRUE(other->wait_frame(frame, kLimitS));
    ASSERT_TRUE(other->advance_to(frame));
  }
  EXPECT_FALSE(told->is_closed());
  EXPECT_EQ(client->stats().reconnects, 0U);
}

}  // namespace
}  // namespace motiongen
