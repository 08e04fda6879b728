// The C interface without a server: struct sizes, missing pointers, truncated texts.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdio>
#include <cstring>
#include <optional>
#include <string>

#include "c/structs.hpp"
#include "c/values.hpp"
#include "motiongen/motiongen.h"

namespace {

motiongen_client_options options_for(const char* address) {
  motiongen_client_options options{};
  options.struct_size = sizeof options;
  options.address = address;
  return options;
}

// The refusal of a client with meaningless options.
motiongen_error refusal_of(const motiongen_client_options& options) {
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = nullptr;
  EXPECT_EQ(motiongen_client_connect(&options, &client, &error), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(client, nullptr);
  EXPECT_EQ(error.code, MOTIONGEN_INVALID_ARGUMENT);
  return error;
}

TEST(CInterface, RefusedOptionsReportReasonAndMessage) {
  const motiongen_error error = refusal_of(options_for("nowhere"));
  EXPECT_STREQ(error.reason, "INVALID_INPUT");
  EXPECT_NE(std::strstr(error.message, "host:port"), nullptr);
}

TEST(CInterface, InvalidTokenIsRefusedWithoutPrintingIt) {
  motiongen_client_options options = options_for("localhost:1");
  options.token = "abc\n";
  const motiongen_error error = refusal_of(options);
  EXPECT_NE(std::strstr(error.message, "0x0a at position 3"), nullptr) << error.message;
  EXPECT_EQ(std::strstr(error.message, "abc"), nullptr) << "it is secret";
}

TEST(CInterface, TokenWithoutTlsIsRefusedToARemoteAddress) {
  motiongen_client_options options = options_for("10.0.0.7:50051");
  options.token = "abc";
  const motiongen_error error = refusal_of(options);
  EXPECT_NE(std::strstr(error.message, "without TLS"), nullptr) << error.message;
}

TEST(CInterface, TokenSourceIsCalledAndItsFailuresAreReported) {
  motiongen_client_options options = options_for("localhost:1");
  options.connect_timeout_s = 0.01;
  int asked = 0;
  options.token_context = &asked;
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = nullptr;
  const auto told = [&](int32_t (*source)(void*, char*, uint32_t)) {
    options.token_source = source;
    motiongen_client_connect(&options, &client, &error);
    return std::string(error.message);
  };
  EXPECT_NE(told([](void* context, char* token, uint32_t size) {
              ++*static_cast<int*>(context);
              std::snprintf(token, size, "abc");
              return 1;
            }).find("no motiongen server answers"),
            std::string::npos);
  EXPECT_GT(asked, 0);
  EXPECT_NE(told([](void*, char*, uint32_t) { return 0; }).find("it returned 0"), std::string::npos);
  EXPECT_STREQ(error.reason, "TOKEN_SOURCE");
  EXPECT_NE(told([](void*, char* token, uint32_t size) {
              std::memset(token, 'x', size);
              return 1;
            }).find("without an end"),
            std::string::npos);
}

TEST(CInterface, WritesOnlyWithinTheCallersStructSize) {
  motiongen_client_options options = options_for("nowhere");
  motiongen_error error;
  std::memset(&error, 'x', sizeof error);
  error.struct_size = offsetof(motiongen_error, reason);
  motiongen_client* client = nullptr;
  motiongen_client_connect(&options, &client, &error);
  EXPECT_EQ(error.struct_size, offsetof(motiongen_error, reason));
  EXPECT_EQ(error.code, MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(error.reason[0], 'x');
}

TEST(CInterface, ReadsOnlyWithinTheCallersStructSize) {
  motiongen_client_options options{};
  options.struct_size = offsetof(motiongen_client_options, token);
  options.address = "nowhere";
  options.token = reinterpret_cast<const char*>(1);  // would be read if the size were ignored
  motiongen_client_options known;
  ASSERT_TRUE(motiongen::c::read(&options, known));
  EXPECT_STREQ(known.address, "nowhere");
  EXPECT_EQ(known.token, nullptr);
  options.struct_size = 0;
  EXPECT_FALSE(motiongen::c::read(&options, known));
}

TEST(CInterface, NullPointersAreRefusedOrIgnored) {
  EXPECT_EQ(motiongen_client_connect(nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_client_open(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_set_prompt(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_rig(nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_copy_frame(nullptr, 0, nullptr, 0, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_sample(nullptr, nullptr, 0), 0);
  EXPECT_EQ(motiongen_session_joint_name(nullptr, 0), nullptr);
  EXPECT_EQ(motiongen_client_next_event(nullptr, nullptr), 0);
  EXPECT_EQ(motiongen_client_generate_clip(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_add_target(nullptr, nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_set_options(nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_placement(nullptr, 1, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_is_durable(nullptr), 0);
  EXPECT_EQ(motiongen_ground_create(nullptr, nullptr, nullptr, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_ground_apply(nullptr, nullptr, 0, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  EXPECT_EQ(motiongen_session_sample_on_ground(nullptr, nullptr, nullptr, 0, nullptr), 0);
  motiongen_ground_destroy(nullptr);
  EXPECT_EQ(motiongen_clip_rows(nullptr, 0, nullptr), nullptr);
  EXPECT_EQ(motiongen_clip_residual(nullptr, 0, 0, nullptr, nullptr), MOTIONGEN_INVALID_ARGUMENT);
  motiongen_clip_destroy(nullptr);
  motiongen_session_destroy(nullptr);
  motiongen_client_destroy(nullptr);
}

motiongen_target target_of(std::uint32_t form) {
  motiongen_target target{};
  target.struct_size = sizeof target;
  target.form = form;
  return target;
}

TEST(CInterface, TargetsOfEveryFormAreReadAndOthersRefused) {
  const float positions[] = {1, 2, 3, 4, 5, 6};
  const float rotations[] = {1, 0, 0, 0, 0, 1, 0, 0};
  const std::uint32_t joints[] = {0, 5};
  for (std::uint32_t form = MOTIONGEN_TARGET_WAYPOINT; form <= MOTIONGEN_TARGET_FOOT_CONTACT; ++form) {
    motiongen_target given = target_of(form);
    given.frame = 40;
    given.positions_m = positions;
    given.num_positions = 2;
    given.joints = joints;
    given.num_joints = 2;
    given.rotations_wxyz = rotations;
    given.has_last_frame = 1;
    given.last_frame = 60;
    given.has_tolerance_m = 1;
    given.tolerance_m = 0.25F;
    given.weight = 0.5F;
    const auto read = motiongen::c::target_of(&given);
    ASSERT_TRUE(read) << read.status().message();
    EXPECT_EQ(read.value().form.index(), form - 1);
    EXPECT_EQ(read.value().last_frame, std::optional<std::uint64_t>(60));
    EXPECT_EQ(read.value().weight, std::optional<float>(0.5F));
    const auto tolerance = std::visit([](const auto& each) { return each.tolerance; }, read.value().form);
    EXPECT_EQ(tolerance.position_m, std::optional<float>(0.25F));
    EXPECT_FALSE(tolerance.rotation_rad);
  }
  const motiongen_target unknown = target_of(99);
  EXPECT_EQ(motiongen::c::target_of(&unknown).status().code(), motiongen::Code::invalid_argument);
  EXPECT_EQ(motiongen::c::target_of(nullptr).status().code(), motiongen::Code::invalid_argument);
}

TEST(CInterface, PromptWithAMissingEmbeddingIsRefused) {
  motiongen_prompt given{};
  given.struct_size = sizeof given;
  given.text = "a person walks";
  EXPECT_TRUE(motiongen::c::prompt_of(&given));
  given.num_embedding = 3;
  const auto refused = motiongen::c::prompt_of(&given);
  EXPECT_EQ(refused.status().code(), motiongen::Code::invalid_argument) << "the text alone would be another prompt";
  EXPECT_NE(refused.status().message().find("embedding"), std::string::npos);
}

TEST(CInterface, SteeringAndAxesWorkWithoutASession) {
  float x = 0;
  float z = 0;
  EXPECT_EQ(motiongen_stick_velocity(0, 1, 0, 3, 0.15F, &x, &z, nullptr), MOTIONGEN_OK);
  EXPECT_FLOAT_EQ(x, 0);
  EXPECT_FLOAT_EQ(z, 3);
  const float points[] = {0, 0, 0, 1, 0, 2};
  float corners[512];
  std::uint32_t count = 0;
  EXPECT_EQ(motiongen_drawn_corners(points, 3, 0.1F, corners, &count, nullptr), MOTIONGEN_OK);
  EXPECT_EQ(count, 2U);
  const float ahead[] = {0, 0, 1};
  float out[3];
  EXPECT_EQ(motiongen_axes_positions(MOTIONGEN_AXES_UNREAL, ahead, out, 1, nullptr), MOTIONGEN_OK);
  EXPECT_FLOAT_EQ(out[0], 100);
  EXPECT_EQ(motiongen_axes_positions(9, ahead, out, 1, nullptr), MOTIONGEN_INVALID_ARGUMENT);
}

TEST(CInterface, TooLongTextsAreCutBetweenCharacters) {
  char to[4];
  motiongen::c::copy_text("ab\xC3\xA9", to);
  EXPECT_STREQ(to, "ab");
  motiongen::c::copy_text("a\xC3\xA9z", to);
  EXPECT_STREQ(to, "a\xC3\xA9");
  motiongen::c::copy_text("abc", to);
  EXPECT_STREQ(to, "abc");
}

}  // namespace
