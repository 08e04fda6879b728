// The C interface and a real server, whose address MOTIONGEN_ADDRESS says.
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>

#include "motiongen/motiongen.h"

namespace {

motiongen_client* connected(motiongen_error* error) {
  motiongen_client_options options{};
  options.struct_size = sizeof options;
  options.address = std::getenv("MOTIONGEN_ADDRESS");
  motiongen_client* client = nullptr;
  EXPECT_EQ(motiongen_client_connect(&options, &client, error), MOTIONGEN_OK) << error->message;
  return client;
}

motiongen_session_options walking() {
  motiongen_session_options character{};
  character.struct_size = sizeof character;
  character.prompt = "a person walks forward";
  return character;
}

TEST(CStream, AFrameThatWasWaitedForIsShownWhateverWasToldJustBefore) {
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = connected(&error);
  ASSERT_NE(client, nullptr);
  motiongen_session_options character = walking();
  character.manual_clock = 1;
  motiongen_session* walker = nullptr;
  ASSERT_EQ(motiongen_client_open(client, &character, &walker, &error), MOTIONGEN_OK) << error.message;
  for (uint64_t frame = 0; frame < 60; ++frame) {
    if (frame % 10 == 5) {
      EXPECT_EQ(motiongen_session_set_velocity(walker, 1, 0, 10, nullptr, 0, nullptr, &error), MOTIONGEN_OK);
    }
    ASSERT_EQ(motiongen_session_wait_frame(walker, frame, 60, &error), MOTIONGEN_OK) << frame << error.message;
    ASSERT_EQ(motiongen_session_advance_to(walker, frame, &error), MOTIONGEN_OK) << frame << error.message;
  }
  motiongen_session_destroy(walker);
  motiongen_client_destroy(client);
}

TEST(CStream, ATextThatIsNotUtf8IsRefusedAndTheOthersPlay) {
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = connected(&error);
  ASSERT_NE(client, nullptr);
  const motiongen_session_options character = walking();
  motiongen_session* told = nullptr;
  motiongen_session* other = nullptr;
  for (motiongen_session** each : {&told, &other}) {
    ASSERT_EQ(motiongen_client_open(client, &character, each, &error), MOTIONGEN_OK) << error.message;
    ASSERT_EQ(motiongen_session_wait_open(*each, 60, &error), MOTIONGEN_OK) << error.message;
  }
  EXPECT_EQ(motiongen_session_set_prompt(told, "\xE9", nullptr, &error), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_STREQ(error.reason, "INVALID_INPUT");
  EXPECT_NE(std::strstr(error.message, "UTF-8"), nullptr) << error.message;
  motiongen_session_options wrong = character;
  wrong.prompt = "\xE9";
  motiongen_session* none = nullptr;
  EXPECT_EQ(motiongen_client_open(client, &wrong, &none, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(none, nullptr);
  const uint64_t later = motiongen_session_buffered_to(other) + 20;
  EXPECT_EQ(motiongen_session_wait_frame(other, later, 60, &error), MOTIONGEN_OK) << error.message;
  for (motiongen_event event{sizeof event}; motiongen_client_next_event(client, &event) != 0;) {
    EXPECT_NE(event.kind, uint32_t{MOTIONGEN_EVENT_CONNECTION_LOST});
  }
  motiongen_session_destroy(told);
  motiongen_session_destroy(other);
  motiongen_client_destroy(client);
}

}  // namespace
