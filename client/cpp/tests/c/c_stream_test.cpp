// The C interface and a real server, whose address is in MOTIONGEN_ADDRESS.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <thread>
#include <vector>

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

TEST(CStream, FrameThatWasWaitedForCanBeShownDespiteAnEditJustBefore) {
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

TEST(CStream, TextThatIsNotUtf8IsRefusedAndOtherSessionsPlay) {
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

double level(void* /*context*/, double /*x_m*/, double /*z_m*/) { return 0; }

TEST(CStream, WrongStructAndBufferSizesAreRefusedWithoutLosingEvents) {
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = connected(&error);
  ASSERT_NE(client, nullptr);
  motiongen_session_options character = walking();
  character.manual_clock = 1;
  motiongen_session* walker = nullptr;
  ASSERT_EQ(motiongen_client_open(client, &character, &walker, &error), MOTIONGEN_OK) << error.message;
  ASSERT_EQ(motiongen_session_wait_frame(walker, 8, 60, &error), MOTIONGEN_OK) << error.message;
  ASSERT_EQ(motiongen_session_advance_to(walker, 4, &error), MOTIONGEN_OK) << error.message;
  motiongen_event event{};
  EXPECT_EQ(motiongen_client_next_event(client, &event), 0) << "its struct_size is 0";
  event.struct_size = sizeof event;
  ASSERT_EQ(motiongen_client_next_event(client, &event), 1);
  EXPECT_EQ(event.kind, uint32_t{MOTIONGEN_EVENT_OPENED}) << "the refused call before must not take it";
  motiongen_rig rig{};
  EXPECT_EQ(motiongen_session_rig(walker, &rig, &error), MOTIONGEN_INVALID_ARGUMENT);
  rig.struct_size = sizeof rig;
  ASSERT_EQ(motiongen_session_rig(walker, &rig, &error), MOTIONGEN_OK);
  motiongen_placement placement{};
  EXPECT_EQ(motiongen_session_placement(walker, 1, &placement, &error), MOTIONGEN_INVALID_ARGUMENT);

  motiongen_ground* ground = nullptr;
  ASSERT_EQ(motiongen_ground_create(walker, level, nullptr, &ground, &error), MOTIONGEN_OK) << error.message;
  std::vector<float> rows(std::size_t{4} * rig.row_floats);
  EXPECT_EQ(motiongen_session_sample_on_ground(walker, ground, rows.data(), rig.row_floats - 1, &error), 0);
  EXPECT_EQ(error.code, MOTIONGEN_INVALID_ARGUMENT) << "a mistake, not a frame that has not arrived";
  EXPECT_EQ(motiongen_session_sample_on_ground(walker, ground, rows.data(), rig.row_floats, &error), 1);
  motiongen_ground_destroy(ground);

  motiongen_session* other = nullptr;
  character.num_prior_rows = 4;
  EXPECT_EQ(motiongen_client_open(client, &character, &other, &error), MOTIONGEN_INVALID_ARGUMENT) << "no rows";
  for (uint64_t frame = 0; frame < 4; ++frame) {
    ASSERT_EQ(motiongen_session_copy_frame(walker, frame, &rows[frame * rig.row_floats], rig.row_floats, &error),
              MOTIONGEN_OK);
  }
  character.prior_rows = rows.data();
  character.num_prior_rows = 2;
  character.prior_row_floats = 2 * rig.row_floats;
  EXPECT_EQ(motiongen_client_open(client, &character, &other, &error), MOTIONGEN_INVALID_ARGUMENT)
      << "rows of another width";
  EXPECT_NE(std::strstr(error.message, "prior_row_floats"), nullptr) << error.message;
  character.num_prior_rows = 4;
  character.prior_row_floats = rig.row_floats;
  ASSERT_EQ(motiongen_client_open(client, &character, &other, &error), MOTIONGEN_OK) << error.message;
  EXPECT_EQ(motiongen_session_wait_open(other, 60, &error), MOTIONGEN_OK) << error.message;
  motiongen_session_destroy(other);
  motiongen_session_destroy(walker);
  motiongen_client_destroy(client);
}

// Two threads that adapt motion to one ground, and whether the second did so during the first.
struct Meeting {
  motiongen_ground* ground = nullptr;
  std::vector<float> rows;
  std::thread::id first;
  std::thread second;
  std::atomic<bool> has_begun{false};
  std::atomic<bool> is_inside{false};
  bool have_met = false;
};

double meet(void* context, double /*x_m*/, double /*z_m*/) {
  auto& meeting = *static_cast<Meeting*>(context);
  if (std::this_thread::get_id() != meeting.first) {
    meeting.is_inside = true;
    return 0;
  }
  if (meeting.second.joinable()) return 0;
  meeting.second = std::thread([&meeting] {
    meeting.has_begun = true;
    std::vector<float> rows = meeting.rows;
    EXPECT_EQ(motiongen_ground_apply(meeting.ground, rows.data(), 1, nullptr), MOTIONGEN_OK);
  });
  while (!meeting.has_begun) std::this_thread::yield();
  for (int time = 0; time < 100'000 && !meeting.is_inside; ++time) std::this_thread::yield();
  meeting.have_met = meeting.is_inside;
  return 0;
}

TEST(CStream, ThreadsThatUseOneGroundTakeTurns) {
  motiongen_error error{};
  error.struct_size = sizeof error;
  motiongen_client* client = connected(&error);
  ASSERT_NE(client, nullptr);
  const motiongen_session_options character = walking();
  motiongen_session* walker = nullptr;
  ASSERT_EQ(motiongen_client_open(client, &character, &walker, &error), MOTIONGEN_OK) << error.message;
  ASSERT_EQ(motiongen_session_wait_frame(walker, 0, 60, &error), MOTIONGEN_OK) << error.message;
  motiongen_rig rig{};
  rig.struct_size = sizeof rig;
  ASSERT_EQ(motiongen_session_rig(walker, &rig, &error), MOTIONGEN_OK);
  Meeting meeting;
  meeting.first = std::this_thread::get_id();
  meeting.rows.resize(rig.row_floats);
  ASSERT_EQ(motiongen_ground_create(walker, meet, &meeting, &meeting.ground, &error), MOTIONGEN_OK) << error.message;
  std::vector<float> rows = meeting.rows;
  EXPECT_EQ(motiongen_ground_apply(meeting.ground, rows.data(), 1, &error), MOTIONGEN_OK) << error.message;
  meeting.second.join();
  EXPECT_FALSE(meeting.have_met) << "both would use the same memory at once";
  EXPECT_TRUE(meeting.is_inside) << "the second thread gets its turn";
  motiongen_ground_destroy(meeting.ground);
  motiongen_session_destroy(walker);
  motiongen_client_destroy(client);
}

}  // namespace
