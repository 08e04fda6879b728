// Messages that only a faulty or hostile server sends: the session ends or ignores them, and the application goes on.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>

#include "client/clip_sample.hpp"
#include "client/convert.hpp"
#include "scripted_server.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kHuge = std::numeric_limits<std::uint64_t>::max();

v1::SessionUpdate opened_at(std::uint64_t start_frame, std::uint32_t lookahead) {
  v1::SessionUpdate update;
  update.mutable_opened()->set_rig_id("r");
  update.mutable_opened()->set_model_id("m");
  update.mutable_opened()->set_start_frame(start_frame);
  update.mutable_opened()->set_lookahead_frames(lookahead);
  return update;
}

TEST(HostileServer, SessionWithATooLargeStartFrameOrLookAheadIsClosed) {
  for (const auto& [start, lookahead, fits] : {std::tuple<std::uint64_t, std::uint32_t, bool>{0, 80, true},
                                               {kLastFrame - 100, 80, true},
                                               {kLastFrame + 1, 80, false},
                                               {kHuge, 80, false},
                                               {0, 0xFFFFFFFF, false}}) {
    Stage stage;
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    stage.open();
    stage.hear(opened_at(start, lookahead));
    EXPECT_EQ(stage.state.phase, fits ? Phase::open : Phase::closed) << start << " " << lookahead;
    EXPECT_EQ(stage.state.ended.reason(), fits ? "" : "PROTOCOL_VIOLATION");
    EXPECT_EQ(stage.num_closed(), fits ? 0 : 1) << "the application gets a closed event";
  }
}

// An update with a frame of that number at one of the places where updates have frames; none behind the last place.
std::optional<v1::SessionUpdate> with_frame(int place, std::uint64_t frame) {
  v1::SessionUpdate update;
  if (place == 0) {
    update.mutable_constraint_reached()->set_frame(frame);
    return update;
  }
  update.mutable_outcome()->set_event_seq(2);
  if (place == 1) {
    update.mutable_outcome()->set_effective_frame(frame);
    return update;
  }
  auto* placement = update.mutable_outcome()->add_placements();
  if (place == 2) placement->set_first_frame(frame);
  if (place == 3) placement->set_last_frame(frame);
  if (place == 4) placement->set_arrival_frame(frame);
  if (place == 5) placement->set_anchor_frame(frame);
  return place < 6 ? std::optional<v1::SessionUpdate>(update) : std::nullopt;
}

TEST(HostileServer, FrameOutOfRangeClosesTheSession) {
  for (int place = 0; with_frame(place, 0); ++place) {
    for (const std::uint64_t frame : {kLastFrame, kLastFrame + 1, kHuge}) {
      Stage stage;
      const std::lock_guard<std::mutex> lock(stage.state.mutex);
      stage.open();
      stage.hear_opened();
      stage.hear(*with_frame(place, frame));
      EXPECT_EQ(stage.state.phase, frame == kLastFrame ? Phase::open : Phase::closed) << place << " " << frame;
      EXPECT_EQ(stage.state.ended.reason(), frame == kLastFrame ? "" : "PROTOCOL_VIOLATION");
      EXPECT_EQ(stage.num_closed(), frame == kLastFrame ? 0 : 1) << "the application gets a closed event";
    }
  }
}

TEST(HostileServer, PlacementOutOfRangeInAnOpenedMessageClosesTheSession) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  v1::SessionUpdate update = opened_at(0, 80);
  update.mutable_opened()->add_placements()->set_anchor_frame(kHuge);
  stage.hear(update);
  EXPECT_EQ(stage.state.ended.reason(), "PROTOCOL_VIOLATION");
}

TEST(HostileServer, SecondOpenedMessageClosesTheSession) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened();
  stage.lose();
  stage.open();
  stage.hear_opened();
  ASSERT_EQ(stage.state.phase, Phase::open);
  stage.hear_opened("another");  // nothing that it says, such as another token, must be applied
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.reason(), "PROTOCOL_VIOLATION");
  EXPECT_EQ(stage.num_closed(), 1) << "the application gets a closed event";
  EXPECT_EQ(stage.sent(v1::SessionEvent::kClose).size(), 1U);
  stage.hear_opened();  // crossed the session's end
  EXPECT_EQ(stage.num_closed(), 0);
}

TEST(HostileServer, ReservedMemoryIsBoundedWhateverLookAheadIsAnnounced) {
  Catalog known = catalog();
  known.rigs[0].blocks.push_back({"wide", 16000});
  known.models[0].horizon_frames = 0xFFFFFFFF;
  Stage stage;
  stage.known = known;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear(opened_at(0, 1 << 16));  // 12 GB of such rows
  EXPECT_EQ(stage.state.phase, Phase::open) << stage.state.ended.message();
}

TEST(HostileServer, HistoryOfAReopenedSessionIsCutToFitOneMessage) {
  Stage stage;
  stage.known.models[0].default_history_frames = 0xFFFFFFFF;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(4);
  for (const std::uint32_t patch : {1U, 4U, 0xFFFFFFFFU}) {
    stage.known.models[0].patch_frames = patch;
    static_cast<void>(stage.sent());
    stage.lose();
    stage.open();
    ASSERT_NE(stage.state.phase, Phase::closed) << stage.state.ended.message();
    const auto said = stage.sent(v1::SessionEvent::kOpen);
    ASSERT_EQ(said.size(), 1U);
    EXPECT_LE(said[0].ByteSizeLong(), stage.known.limits.max_request_bytes);
    EXPECT_EQ(said[0].open().prior_frames().frame_count() > 0, patch < 5);
  }
}

TEST(HostileServer, MaxRequestBytesOfAServerIsCapped) {
  v1::GetCatalogResponse message;
  message.add_models()->set_model_id("m");
  message.mutable_limits()->set_max_request_bytes(0xFFFFFFFF);
  const auto known = convert::catalog(message);
  ASSERT_TRUE(known);
  EXPECT_LE(known.value()->limits.max_request_bytes, 1U << 26);
}

TEST(HostileServer, OnlyTheFirstThreeOtherServersAreRead) {
  v1::EditOutcome message;
  for (int number = 0; number < 1000; ++number) message.add_other_servers()->set_routing_key(std::to_string(number));
  const auto servers = convert::outcome(message).other_servers;
  ASSERT_EQ(servers.size(), 3U);
  EXPECT_EQ(servers[2].routing_key, "2");
}

TEST(HostileServer, RetryDelayOfARefusalIsCappedAtAnHour) {
  Stage stage;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.lose();
  stage.open();
  v1::SessionUpdate update;
  update.mutable_outcome()->set_event_seq(1);
  update.mutable_outcome()->set_code(static_cast<int>(Code::resource_exhausted));
  update.mutable_outcome()->mutable_retry_after()->set_seconds(3'000'000'000);
  stage.hear(update);
  EXPECT_EQ(stage.state.phase, Phase::waiting);
  EXPECT_EQ(stage.state.retry_at_s, 3600) << "the refusal came at 0 s";
}

TEST(HostileServer, MalformedUpdateEndsTheStreamWithProtocolViolation) {
  ScriptedServer server;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (!event.has_open()) return;
    v1::StreamMotionResponse said;  // with an update whose first varint does not end
    said.GetReflection()->MutableUnknownFields(&said)->AddLengthDelimited(v1::StreamMotionResponse::kUpdatesFieldNumber,
                                                                          "\xFF\xFF");
    stream.Write(said);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session);
  EXPECT_EQ(session->wait_open(60).status().reason(), "PROTOCOL_VIOLATION");
}

TEST(HostileServer, UnsolicitedPongDoesNotSetTheRoundTrip) {
  ScriptedServer server;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (!event.has_open()) return;
    v1::StreamMotionResponse said;
    said.mutable_pong()->set_client_time_ns(std::numeric_limits<std::int64_t>::min());
    said.add_updates()->set_session(event.session());
    said.mutable_updates(0)->mutable_opened()->set_rig_id("r");
    said.mutable_updates(0)->mutable_opened()->set_model_id("m");
    stream.Write(said);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session && session->wait_open(60));
  const double round_trip_s = client->stats().round_trip_s;
  EXPECT_GE(round_trip_s, 0);
  EXPECT_LT(round_trip_s, 1e6) << "the pong claims three centuries";
}

// The parts of a clip of ten frames.
struct Parts {
  Catalog known = catalog();
  ClipOptions options;
  ClipSample sample;

  Parts() {
    options.num_frames = 10;
    Rig wide = known.rigs[0];
    wide.rig_id = "wide";
    wide.blocks.push_back({"more", 100});
    known.rigs.push_back(wide);
  }

  Status open(const char* rig) {
    v1::GenerateClipResponse part;
    part.mutable_opened()->set_rig_id(rig);
    return sample.take(part, known, options);
  }

  Status add(std::uint32_t num_frames) {
    v1::GenerateClipResponse part;
    part.mutable_chunk()->set_first_frame(sample.clip.num_frames);
    part.mutable_chunk()->set_frame_count(num_frames);
    part.mutable_chunk()->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
    part.mutable_chunk()->set_data(std::string(std::size_t{num_frames} * sample.clip.rig.row_width * 4, '\0'));
    return sample.take(part, known, options);
  }

  Status end(int num_residuals) {
    v1::GenerateClipResponse part;
    part.mutable_summary();
    for (int residual = 0; residual < num_residuals; ++residual) part.mutable_summary()->add_residuals();
    return sample.take(part, known, options);
  }
};

TEST(HostileServer, ClipOpenedTwiceIsAProtocolViolation) {
  Parts parts;
  ASSERT_TRUE(parts.open("r"));
  ASSERT_TRUE(parts.add(1));
  EXPECT_EQ(parts.open("wide").reason(), "PROTOCOL_VIOLATION") << "rows of this rig are wider than those before";
}

TEST(HostileServer, ClipWithMoreFramesThanRequestedIsAProtocolViolation) {
  Parts parts;
  ASSERT_TRUE(parts.open("r"));
  ASSERT_TRUE(parts.add(8));
  EXPECT_EQ(parts.add(3).reason(), "PROTOCOL_VIOLATION");
  EXPECT_TRUE(parts.add(2));
  EXPECT_EQ(parts.sample.clip.num_frames, 10U);
}

TEST(HostileServer, ClipWithTwoSummariesOrExtraResidualsIsAProtocolViolation) {
  Parts parts;
  EXPECT_EQ(parts.end(1).reason(), "PROTOCOL_VIOLATION");
  EXPECT_TRUE(parts.end(0));
  EXPECT_EQ(parts.end(0).reason(), "PROTOCOL_VIOLATION");
}

TEST(HostileServer, RepeatedOpenedMessagesRequestNoCatalogue) {
  ScriptedServer server;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (!event.has_open()) return;
    v1::StreamMotionResponse said;
    for (int time = 0; time < 100; ++time) {
      auto* update = said.add_updates();
      update->set_session(event.session());
      update->mutable_opened()->set_rig_id(time == 0 ? "r" : "unheard-of");
      update->mutable_opened()->set_model_id("m");
    }
    stream.Write(said);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session);
  EXPECT_EQ(session->wait_frame(0, 60).reason(), "PROTOCOL_VIOLATION");
  EXPECT_EQ(server.num_catalogs, 1);
}

}  // namespace
}  // namespace motiongen
