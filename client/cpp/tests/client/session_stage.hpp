// A session without a client, for unit tests: it is given the server's messages, and what it would send is read.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "client/session_state.hpp"
#include "motiongen/v1/service.pb.h"

namespace motiongen {

inline Catalog catalog() {
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
  made.limits.max_request_bytes = 4096;
  return made;
}

// One session with its outbox and events.
struct Stage {
  Catalog known = catalog();
  EventQueue events{nullptr};
  Outbox outbox;
  SessionState state;

  explicit Stage(v1::OpenSession open = {}, SessionOptions options = {})
      : state(1, std::move(options), std::move(open), true) {
    outbox.set_limit(known.limits.max_request_bytes);
  }

  void open() { state.send_open(outbox, known, events); }

  void hear(const v1::SessionUpdate& update) { state.take(update, known, 0, events, outbox); }

  void hear_opened(const char* token = "t", const char* rig = "r") {
    v1::SessionUpdate update;
    update.mutable_opened()->set_rig_id(rig);
    update.mutable_opened()->set_model_id("m");
    update.mutable_opened()->set_session_token(token);
    update.mutable_opened()->set_denoise_steps(8);
    hear(update);
  }

  void lose() { state.lose(Status(Code::unavailable, "", "cut"), true, events); }

  // Give it the frames below `end`, as if they had arrived, committed up to `committed_to`.
  void hold(std::uint64_t end, std::uint64_t committed_to = 0) {
    const std::vector<float> rows(end * state.rig.row_width);
    RowSpan stored({rows.data(), rows.size()});
    ASSERT_TRUE(state.timeline->announce_plan(1, 0, false));
    ASSERT_TRUE(state.timeline->add_chunk({1, 0, static_cast<std::uint32_t>(end), committed_to}, stored));
  }

  // Takes all events that wait to be sent.
  std::vector<v1::SessionEvent> sent() {
    std::vector<v1::SessionEvent> all;
    for (std::string text; outbox.take(text);) {
      v1::StreamMotionRequest message;
      EXPECT_TRUE(message.ParseFromString(text));
      all.insert(all.end(), message.events().begin(), message.events().end());
    }
    return all;
  }

  // Takes all of them and returns those of one kind.
  std::vector<v1::SessionEvent> sent(v1::SessionEvent::EventCase kind) {
    std::vector<v1::SessionEvent> found;
    for (const v1::SessionEvent& each : sent()) {
      if (each.event_case() == kind) found.push_back(each);
    }
    return found;
  }

  // A refusal of its open.
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

}  // namespace motiongen
