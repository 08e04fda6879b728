// The C interface without a server: sizes of structs, missing pointers, texts that are cut off.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>

#include "c/structs.hpp"
#include "motiongen/motiongen.h"

namespace {

TEST(CInterface, SaysWhatIsWrong) {
  motiongen_client_options options{};
  options.struct_size = sizeof options;
  options.address = "nowhere";
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = nullptr;
  EXPECT_EQ(motiongen_client_connect(&options, &client, &error), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(client, nullptr);
  EXPECT_EQ(error.code, MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_STREQ(error.reason, "INVALID_INPUT");
  EXPECT_NE(std::strstr(error.message, "host:port"), nullptr);
}

TEST(CInterface, WritesNoFurtherThanTheCallersStructGoes) {
  motiongen_client_options options{};
  options.struct_size = sizeof options;
  options.address = "nowhere";
  motiongen_error error;
  std::memset(&error, 'x', sizeof error);
  error.struct_size = offsetof(motiongen_error, reason);
  motiongen_client* client = nullptr;
  motiongen_client_connect(&options, &client, &error);
  EXPECT_EQ(error.struct_size, offsetof(motiongen_error, reason));
  EXPECT_EQ(error.code, MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(error.reason[0], 'x');
}

TEST(CInterface, ReadsNoFurtherThanTheCallersStructGoes) {
  motiongen_client_options options{};
  options.struct_size = offsetof(motiongen_client_options, token);
  options.address = "nowhere";
  options.token = reinterpret_cast<const char*>(1);  // would be read otherwise
  motiongen_client_options known;
  ASSERT_TRUE(motiongen::c::read(&options, known));
  EXPECT_STREQ(known.address, "nowhere");
  EXPECT_EQ(known.token, nullptr);
  options.struct_size = 0;
  EXPECT_FALSE(motiongen::c::read(&options, known));
}

TEST(CInterface, TakesMissingPointers) {
  EXPECT_EQ(motiongen_client_connect(nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_client_open(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_set_prompt(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_rig(nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_copy_frame(nullptr, 0, nullptr, 0, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_sample(nullptr, nullptr, 0), 0);
  EXPECT_EQ(motiongen_session_joint_name(nullptr, 0), nullptr);
  EXPECT_EQ(motiongen_client_next_event(nullptr, nullptr), 0);
  EXPECT_EQ(motiongen_client_generate_clip(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_clip_rows(nullptr, 0, nullptr), nullptr);
  EXPECT_EQ(motiongen_clip_residual(nullptr, 0, 0, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  motiongen_clip_destroy(nullptr);
  motiongen_session_destroy(nullptr);
  motiongen_client_destroy(nullptr);
}

TEST(CInterface, CutsTextsBetweenCharacters) {
  char to[4];
  motiongen::c::copy_text("ab\xC3\xA9", to);
  EXPECT_STREQ(to, "ab");
  motiongen::c::copy_text("a\xC3\xA9z", to);
  EXPECT_STREQ(to, "a\xC3\xA9");
  motiongen::c::copy_text("abc", to);
  EXPECT_STREQ(to, "abc");
}

}  // namespace
