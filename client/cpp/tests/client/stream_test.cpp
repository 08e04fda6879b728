// The client and a real server, whose address is in MOTIONGEN_ADDRESS. No test depends on how fast either is.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "live_server.hpp"
#include "motiongen/client/client.hpp"

namespace motiongen {
namespace {

TEST(Stream, ConnectingToAnAddressWithoutAServerNamesIt) {
  ClientOptions options = server();
  options.address = "localhost:1";
  options.connect_timeout_s = 0.3;
  const auto refused = Client::connect(options);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.status().code(), Code::unavailable);
  EXPECT_NE(refused.status().message().find("localhost:1"), std::string::npos);
  options.address = "nonsense";
  EXPECT_EQ(Client::connect(options).status().code(), Code::invalid_argument);
}

TEST(Stream, SessionPlaysAndAcceptsAPrompt) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  EXPECT_FALSE(client->catalog()->models.empty());
  auto walker = client->open(walking());
  ASSERT_TRUE(walker);
  const auto opened = walker->wait_open(kLimitS);
  ASSERT_TRUE(opened) << opened.status().message();
  EXPECT_EQ(opened.value().seed, 3U);
  ASSERT_TRUE(walker->wait_frame(0, kLimitS));
  std::vector<float> row(walker->rig().row_width);
  for (std::uint64_t frame = 0; frame < 100; ++frame) {
    ASSERT_TRUE(walker->wait_frame(frame, kLimitS)) << frame;
    ASSERT_TRUE(walker->advance_to(frame));
    ASSERT_TRUE(walker->copy_frame(frame, row));
    if (frame == 20) {
      const auto edit = walker->set_prompt("a person runs forward and waves");
      ASSERT_TRUE(edit);
      const auto outcome = walker->wait_edit(*const_cast<Result<EditId>&>(edit), kLimitS);
      ASSERT_TRUE(outcome);
      EXPECT_TRUE(outcome.value().status) << outcome.value().status.message();
      ASSERT_TRUE(outcome.value().effective_frame);
      EXPECT_GT(*outcome.value().effective_frame, 20U);
    }
  }
  EXPECT_GE(walker->stats().plans, 2U);
  ASSERT_TRUE(walker->close());
  EXPECT_EQ(walker->set_prompt("anything").status().code(), Code::failed_precondition);
}

TEST(Stream, EditsWhileFramesAreTakenAsTheyComeReplaceNoTakenFrame) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  auto walker = client->open(walking());
  for (std::uint64_t frame = 0; frame < 150; ++frame) {
    ASSERT_TRUE(walker->wait_frame(frame, kLimitS)) << frame;
    const Status shown = walker->advance_to(frame);
    ASSERT_TRUE(shown) << frame << ": " << shown.message();
    if (frame % 25 != 10) continue;
    ASSERT_TRUE(walker->wait_frame(frame + 15, kLimitS)) << "the edit must find frames that it may replace";
    ASSERT_TRUE(walker->set_velocity(frame % 50 == 10 ? 1.0F : -1.0F, 0, 10));
  }
  EXPECT_EQ(walker->stats().late_plans, 0U);
}

TEST(Stream, SampleOnGroundRaisesTheCharacterAndRefusesInvalidGround) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client) << client.status().message();
  auto walker = client->open(walking());
  ASSERT_TRUE(walker->wait_frame(0, kLimitS));
  auto plateau = Ground::make(walker->rig(), [](double, double) { return 100.0; });
  ASSERT_TRUE(plateau) << plateau.status().message();
  GroundFollower feet(std::move(plateau).value());
  std::vector<float> level(walker->rig().row_width);
  std::vector<float> raised = level;
  const auto before = walker->sample_on_ground(feet, raised);
  ASSERT_TRUE(before);
  EXPECT_FALSE(before.value()) << "no frame has been shown";
  for (std::uint64_t frame = 0; frame <= 40; ++frame) {
    ASSERT_TRUE(walker->wait_frame(frame, kLimitS));
    ASSERT_TRUE(walker->advance_to(frame));
    ASSERT_TRUE(walker->copy_frame(frame, level));
    const auto shown = walker->sample_on_ground(feet, raised);
    ASSERT_TRUE(shown && shown.value());
    const auto from = walker->rig().root_translation_m(level);
    const auto to = walker->rig().root_translation_m(raised);
    EXPECT_NEAR(to[1], from[1] + 100, 5) << frame << ": jumps of this model fade";
  }
  auto broken = Ground::make(walker->rig(), [](double, double) { return std::numeric_limits<double>::quiet_NaN(); });
  GroundFollower nowhere(std::move(broken).value());
  EXPECT_EQ(walker->sample_on_ground(nowhere, raised).status().code(), Code::invalid_argument);
  EXPECT_EQ(walker->sample_on_ground(feet, {raised.data(), 1}).status().code(), Code::invalid_argument);
  EXPECT_EQ(walker->frame_in(HUGE_VAL), walker->playhead() + kLastFrame) << "bounded to the last frame";
}

TEST(Stream, RefusedEditDoesNotAffectTheSession) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  auto walker = client->open(walking());
  ASSERT_TRUE(walker->wait_open(kLimitS));
  const std::uint32_t unknown = 99;
  auto edit = walker->remove_targets({&unknown, 1});
  ASSERT_TRUE(edit);
  const auto outcome = walker->wait_edit(*edit, kLimitS);
  ASSERT_TRUE(outcome);
  EXPECT_EQ(outcome.value().status.reason(), "UNKNOWN_CONSTRAINT");
  EXPECT_EQ(outcome.value().status.code(), Code::not_found);
  const Target nowhere = Waypoint{50, std::numeric_limits<float>::quiet_NaN(), 0, {}};
  EXPECT_EQ(walker->add_targets({&nowhere, 1}).status().code(), Code::invalid_argument);
  EXPECT_TRUE(walker->wait_frame(10, kLimitS));
}

TEST(Stream, RefusedOpenIsReportedAndOtherSessionsPlay) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  auto walker = client->open(walking());
  SessionOptions wrong = walking();
  wrong.model_id = "no-such-model";
  auto refused = client->open(wrong);
  ASSERT_TRUE(refused);
  const auto opened = refused->wait_open(kLimitS);
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.status().reason(), "UNKNOWN_MODEL");
  EXPECT_TRUE(refused->is_closed());
  EXPECT_TRUE(walker->wait_frame(10, kLimitS));
}

TEST(Stream, ResultsOfTargetsAreReported) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  auto walker = client->open(walking());
  ASSERT_TRUE(walker->wait_frame(0, kLimitS));
  ASSERT_TRUE(walker->advance_to(0));
  Waypoint near{40, 0, 0.5F, {}};
  near.tolerance.position_m = 1000;
  HeadingTarget turned{40, 2.0F};
  turned.tolerance.rotation_rad = 1e-6F;
  const Target targets[] = {near, turned};
  std::vector<std::uint32_t> ids;
  const auto edit = walker->add_targets({targets, 2}, &ids);
  ASSERT_TRUE(edit);
  ASSERT_TRUE(walker->wait_edit(edit.value(), kLimitS).value().status);
  for (std::uint64_t frame = 0; frame < 60; ++frame) {
    ASSERT_TRUE(walker->wait_frame(frame, kLimitS));
    ASSERT_TRUE(walker->advance_to(frame));
  }
  const auto met = walker->wait_reached(ids[0], kLimitS);
  ASSERT_TRUE(met) << met.status().message();
  EXPECT_TRUE(met.value().met);
  EXPECT_EQ(met.value().frame, 40U);
  EXPECT_TRUE(met.value().position_error_m);
  EXPECT_FALSE(met.value().rotation_error_rad);
  const auto missed = walker->wait_reached(ids[1], kLimitS);
  ASSERT_TRUE(missed);
  EXPECT_FALSE(missed.value().met);
  EXPECT_GT(missed.value().rotation_error_rad.value_or(0), 1e-6F);
  int told = 0;
  for (Event event; client->next_event(event);) told += event.kind == EventKind::reached ? 1 : 0;
  EXPECT_EQ(told, 2);
  near.tolerance.position_m = -1;
  const Target wrong = near;
  EXPECT_EQ(walker->add_targets({&wrong, 1}).status().code(), Code::invalid_argument);
}

TEST(Stream, ClipsHaveAllFramesAndResidualsOfTheirTargets) {
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  ClipOptions options;
  options.num_frames = 50;
  options.num_samples = 2;
  options.prompt = "a person walks forward";
  options.later_prompts = {{30, "a person waves"}};
  options.targets = {Waypoint{40, 0, 1, {}}, JointRotations{45, {5}, {1, 0, 0, 0}, {}}};
  options.seed = 9;
  const auto clips = client->generate_clip(options);
  ASSERT_TRUE(clips) << clips.status().message();
  ASSERT_EQ(clips.value().size(), 2U);
  for (std::size_t sample = 0; sample < 2; ++sample) {
    const Clip& clip = clips.value()[sample];
    EXPECT_EQ(clip.opened.seed, 9 + sample);
    EXPECT_EQ(clip.rows.size(), 50 * client->catalog()->rigs[0].row_width);
    ASSERT_EQ(clip.residuals.size(), 2U);
    EXPECT_TRUE(clip.residuals[0].position_m);
    EXPECT_FALSE(clip.residuals[0].rotation_rad);
    EXPECT_TRUE(clip.residuals[1].rotation_rad);
  }
  EXPECT_NE(clips.value()[0].rows, clips.value()[1].rows);
  options.num_frames = 0;
  EXPECT_EQ(client->generate_clip(options).status().code(), Code::invalid_argument);
  options.num_frames = 50;
  options.model_id = "no-such-model";
  EXPECT_EQ(client->generate_clip(options).status().reason(), "UNKNOWN_MODEL");
  options.model_id.clear();
  options.timeout_s = 1e-3;
  EXPECT_EQ(client->generate_clip(options).status().code(), Code::deadline_exceeded);
}

TEST(Stream, ManySessionsShareOneStream) {
  constexpr int kMany = 40;
  auto client = Client::connect(server());
  ASSERT_TRUE(client);
  std::vector<Session> sessions;
  for (int number = 0; number < kMany; ++number) {
    auto session = client->open(walking());
    ASSERT_TRUE(session);
    sessions.push_back(std::move(session).value());
  }
  for (Session& session : sessions) ASSERT_TRUE(session.wait_frame(4, kLimitS));
  std::vector<float> first(sessions[0].rig().row_width);
  std::vector<float> other(first.size());
  ASSERT_TRUE(sessions[0].copy_frame(3, first));
  ASSERT_TRUE(sessions[kMany - 1].copy_frame(3, other));
  for (std::size_t column = 0; column < first.size(); ++column) EXPECT_NEAR(first[column], other[column], 1e-3);
  EXPECT_LT(client->stats().messages, client->stats().chunks + kMany);
}

}  // namespace
}  // namespace motiongen
