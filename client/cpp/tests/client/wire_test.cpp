#include "client/wire.hpp"

#include <google/protobuf/descriptor.h>
#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "motiongen/v1/service.pb.h"

namespace motiongen {
namespace {

using wire::Cursor;
using wire::Piece;

// The bytes of a message in two pieces, cut at `at`, with an empty piece between them.
struct Cut {
  Cut(const std::string& encoded, std::size_t at)
      : pieces{piece(encoded, 0, at), Piece{}, piece(encoded, at, encoded.size())}, size(encoded.size()) {}
  static Piece piece(const std::string& text, std::size_t from, std::size_t to) {
    return {reinterpret_cast<const std::uint8_t*>(text.data()) + from, to - from};
  }
  Cursor cursor() const { return {pieces, size}; }
  Piece pieces[3];
  std::size_t size;
};

v1::SessionUpdate chunk_update() {
  v1::SessionUpdate update;
  update.set_session(300);
  update.set_applied_seq(1234567890123);
  auto* chunk = update.mutable_chunk();
  chunk->set_plan(7);
  chunk->set_first_frame(std::uint64_t{1} << 52);
  chunk->set_frame_count(2);
  chunk->set_committed_to(99);
  chunk->set_data(std::string("0123456789abcdef"));
  chunk->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
  return update;
}

TEST(Wire, ChunkIsReadWhereverTheMessageIsSplit) {
  const std::string encoded = chunk_update().SerializeAsString();
  for (std::size_t at = 0; at <= encoded.size(); ++at) {
    const Cut cut(encoded, at);
    wire::Update update;
    wire::Chunk chunk;
    ASSERT_TRUE(wire::read_update(cut.cursor(), update));
    ASSERT_EQ(update.session, 300U);
    ASSERT_EQ(update.applied_seq, 1234567890123U);
    ASSERT_EQ(update.kind, wire::Update::Kind::chunk);
    ASSERT_TRUE(wire::read_chunk(update.body, chunk));
    ASSERT_EQ(chunk.header.plan, 7U);
    ASSERT_EQ(chunk.header.first_frame, std::uint64_t{1} << 52);
    ASSERT_EQ(chunk.header.num_frames, 2U);
    ASSERT_EQ(chunk.header.committed_to, 99U);
    ASSERT_EQ(chunk.scalar_type, static_cast<std::uint64_t>(v1::SCALAR_TYPE_F32_LE));
    wire::ChunkRows rows(chunk.data);
    ASSERT_EQ(rows.num_bytes(), 16U);
    std::string taken(8, ' ');
    rows.take(8, nullptr);
    rows.take(8, taken.data());
    ASSERT_EQ(taken, "89abcdef");
  }
}

TEST(Wire, PlansAreReadAndOtherUpdatesLeftUndecoded) {
  v1::SessionUpdate update;
  update.set_session(5);
  update.mutable_plan()->set_plan(3);
  update.mutable_plan()->set_valid_from(40);
  update.mutable_plan()->add_event_seqs(2);
  std::string encoded = update.SerializeAsString();
  wire::Update read;
  wire::Plan plan;
  const Cut with_plan(encoded, 4);
  ASSERT_TRUE(wire::read_update(with_plan.cursor(), read));
  ASSERT_EQ(read.kind, wire::Update::Kind::plan);
  ASSERT_TRUE(wire::read_plan(read.body, plan));
  EXPECT_EQ(plan.plan, 3U);
  EXPECT_EQ(plan.valid_from, 40U);
  update.mutable_outcome()->set_event_seq(2);
  encoded = update.SerializeAsString();
  const Cut with_outcome(encoded, 4);
  ASSERT_TRUE(wire::read_update(with_outcome.cursor(), read));
  EXPECT_EQ(read.kind, wire::Update::Kind::other);
  std::string all;
  ASSERT_TRUE(wire::gather(read.all, all));
  EXPECT_EQ(all, encoded);
}

TEST(Wire, TruncatedUpdatesAreRefusedAsByProtobuf) {
  const std::string encoded = chunk_update().SerializeAsString();
  for (std::size_t size = 1; size < encoded.size(); ++size) {
    const std::string part = encoded.substr(0, size);
    const Cut cut(part, 0);
    wire::Update update;
    v1::SessionUpdate message;
    EXPECT_EQ(wire::read_update(cut.cursor(), update), message.ParseFromString(part)) << size;
  }
}

TEST(Wire, CorruptedBytesAreNotReadPastTheirEnd) {
  std::minstd_rand draw(1);
  const std::string good = chunk_update().SerializeAsString();
  for (int trial = 0; trial < 20'000; ++trial) {
    std::string bytes = good;
    for (int change = 0; change < 3; ++change) bytes[draw() % bytes.size()] = static_cast<char>(draw() % 256);
    wire::Update update;
    wire::Chunk chunk;
    wire::Plan plan;
    const Cut cut(bytes, draw() % bytes.size());
    if (!wire::read_update(cut.cursor(), update)) continue;
    std::string all;
    if (wire::read_chunk(update.body, chunk)) {
      EXPECT_TRUE(wire::gather(chunk.data, all));
    }
    static_cast<void>(wire::read_plan(update.body, plan));
  }
}

TEST(Wire, ReportIsWrittenAsItsMessage) {
  std::string entry;
  wire::put_playhead(0xFFFFFFFF, std::uint64_t{1} << 53, (std::uint64_t{1} << 53) + 1, 0xFFFFFFFF, ~std::uint64_t{0},
                     entry);
  v1::StreamMotionRequest request;
  ASSERT_TRUE(request.ParseFromString(entry));
  ASSERT_EQ(request.events_size(), 1);
  EXPECT_EQ(request.events(0).session(), 0xFFFFFFFF);
  EXPECT_EQ(request.events(0).event_seq(), 0U);
  EXPECT_EQ(request.events(0).playhead().frame(), std::uint64_t{1} << 53);
  EXPECT_EQ(request.events(0).playhead().buffered_to(), (std::uint64_t{1} << 53) + 1);
  EXPECT_EQ(request.events(0).playhead().underruns(), 0xFFFFFFFF);
  EXPECT_EQ(request.events(0).playhead().answered_seq(), ~std::uint64_t{0});
}

TEST(Wire, UnknownFieldDoesNotHideAChunk) {
  v1::SessionUpdate update = chunk_update();
  update.GetReflection()->MutableUnknownFields(&update)->AddLengthDelimited(100, "later");
  const std::string encoded = update.SerializeAsString();
  const Cut cut(encoded, 4);
  wire::Update read;
  ASSERT_TRUE(wire::read_update(cut.cursor(), read));
  EXPECT_EQ(read.kind, wire::Update::Kind::chunk);
  wire::Chunk chunk;
  ASSERT_TRUE(wire::read_chunk(read.body, chunk));
  EXPECT_EQ(chunk.header.num_frames, 2U);
}

TEST(Wire, EveryMemberOfAnUpdateIsClassified) {
  const auto* members = v1::SessionUpdate::descriptor()->FindOneofByName("update");
  for (int place = 0; place < members->field_count(); ++place) {
    const auto* member = members->field(place);
    v1::SessionUpdate later;
    later.GetReflection()->MutableMessage(&later, member);
    const std::string encoded = chunk_update().SerializeAsString() + later.SerializeAsString();  // the last one counts
    const Cut cut(encoded, 4);
    wire::Update read;
    ASSERT_TRUE(wire::read_update(cut.cursor(), read));
    const auto expected = member->name() == "chunk"  ? wire::Update::Kind::chunk
                          : member->name() == "plan" ? wire::Update::Kind::plan
                                                     : wire::Update::Kind::other;
    EXPECT_EQ(read.kind, expected) << member->name();
  }
}

}  // namespace
}  // namespace motiongen
