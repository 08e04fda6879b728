#include "client/session_state.hpp"

#include <gtest/gtest.h>

namespace motiongen {
namespace {

Catalog catalog() {
  Catalog made;
  Rig rig;
  rig.rig_id = "r";
  rig.joint_names = {"Hips"};
  rig.parents = {-1};
  rig.offsets_m = {0, 0, 0};
  rig.frame_rate_hz = 20;
  rig.blocks = {{"root_translation_m", 3}, {"joint_rotation_quat_wxyz", 4}, {"foot_contact", 4}};
  made.rigs = {rig};
  made.models.emplace_back();
  made.models[0].model_id = "m";
  made.models[0].rig_id = "r";
  return made;
}

// One session and what it meets, without a client.
struct Stage {
  const Catalog known = catalog();
  EventQueue events{nullptr};
  Outbox outbox;
  SessionState state{1, {}, {}, true};

  void open() { state.send_open(outbox, known); }

  void hear(const v1::SessionUpdate& update) { state.take(update, known, 0, events, outbox); }

  void hear_opened() {
    v1::SessionUpdate update;
    update.mutable_opened()->set_rig_id("r");
    update.mutable_opened()->set_model_id("m");
    update.mutable_opened()->set_session_token("t");
    hear(update);
  }

  // The answer to its open.
  void hear_refused(Code code) {
    v1::SessionUpdate update;
    auto* outcome = update.mutable_outcome();
    outcome->set_event_seq(1);
    outcome->set_code(static_cast<int>(code));
    outcome->add_other_servers()->set_address("other:1");
    hear(update);
  }

  int num_closed() {
    int count = 0;
    for (Event event; events.take(event);) count += event.kind == EventKind::closed ? 1 : 0;
    return count;
  }
};

TEST(SessionState, EndsWhereItsOpenIsRefusedAfterItWasClosed) {
  for (const Code code : {Code::resource_exhausted, Code::unavailable, Code::not_found}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.state.send_close(stage.outbox);
    ASSERT_EQ(stage.state.phase, Phase::closing);
    stage.hear_refused(code);
    EXPECT_EQ(stage.state.phase, Phase::closed);
    EXPECT_EQ(stage.state.ended.reason(), "CLIENT");
    EXPECT_FALSE(stage.state.refusal) << "no other server is to be asked";
    EXPECT_EQ(stage.num_closed(), 0) << "it ended as its user wished";
  }
}

TEST(SessionState, EndsWhereItsResumeIsRefusedAfterItWasClosed) {
  for (const Code code : {Code::not_found, Code::unavailable}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.hear_opened();
    ASSERT_EQ(stage.state.phase, Phase::open) << stage.state.ended.message();
    stage.state.lose(Status(Code::unavailable, "", "cut"), true, stage.events);
    stage.open();
    stage.state.send_close(stage.outbox);
    stage.hear_refused(code);
    EXPECT_EQ(stage.state.phase, Phase::closed);
    EXPECT_EQ(stage.num_closed(), 0);
  }
}

TEST(SessionState, ThatIsRefusedBeforeItIsClosedAsksAnotherServer) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_refused(Code::resource_exhausted);
  EXPECT_EQ(stage.state.phase, Phase::waiting);
  ASSERT_TRUE(stage.state.refusal);
  EXPECT_EQ(stage.state.refusal->other_servers.size(), 1U);
}

}  // namespace
}  // namespace motiongen
