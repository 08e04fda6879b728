// Reads protobuf's encoding in place, so that frames go from gRPC's buffers into timelines with a single copy.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "motiongen/core/timeline.hpp"

namespace motiongen::wire {

// Consecutive bytes; a message may consist of several pieces.
struct Piece {
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
};

// A position in a message and how many bytes may be read from it. A copy is a bookmark. Reading past the end fails.
class Cursor {
 public:
  Cursor() = default;
  // The pieces must stay valid while this is used; `size` is their total in bytes.
  Cursor(const Piece* pieces, std::size_t size) : piece_(pieces), left_(size) {}

  std::size_t left() const { return left_; }
  bool read_varint(std::uint64_t& value);
  // Copy the next `count` bytes to `to`, or skip them if it is nullptr.
  bool copy(std::size_t count, void* to);
  bool skip(std::size_t count) { return copy(count, nullptr); }
  // Read a length-delimited field: `inner` covers its bytes, and this cursor skips them.
  bool read_message(Cursor& inner);
  // A field's number and wire type; also false at the end.
  bool read_tag(std::uint32_t& field, std::uint32_t& type);
  // Skip the value of a field of a wire type.
  bool skip_value(std::uint32_t type);

 private:
  const Piece* piece_ = nullptr;
  std::size_t at_ = 0;
  std::size_t left_ = 0;
};

constexpr std::uint32_t kVarint = 0;
constexpr std::uint32_t kFixed64 = 1;
constexpr std::uint32_t kLength = 2;
constexpr std::uint32_t kFixed32 = 5;

// Rows of a chunk, read in place from the message.
class ChunkRows final : public RowSource {
 public:
  explicit ChunkRows(Cursor data) : data_(data) {}
  std::size_t num_bytes() const override { return data_.left(); }
  void take(std::size_t count, void* to) override { data_.copy(count, to); }

 private:
  Cursor data_;
};

struct Chunk {
  ChunkHeader header;
  std::uint64_t scalar_type = 0;
  Cursor data;
  float origin_m[3] = {0, 0, 0};
  std::size_t num_origin = 0;  // how many there are; 4: too many
};

struct Plan {
  std::uint32_t plan = 0;
  std::uint64_t valid_from = 0;
  bool is_cut = false;
};

// A SessionUpdate: its session and what it contains. Plans and chunks are read from `body`, all else is parsed from
// `all`.
struct Update {
  enum class Kind { plan, chunk, other };
  std::uint32_t session = 0;
  std::uint64_t applied_seq = 0;
  Kind kind = Kind::other;
  Cursor body;
  Cursor all;
};

bool read_update(Cursor cursor, Update& update);
bool read_chunk(Cursor cursor, Chunk& chunk);
bool read_plan(Cursor cursor, Plan& plan);

// All bytes of a cursor in one string.
bool gather(Cursor cursor, std::string& to);

// ---- writing

void put_varint(std::uint64_t value, std::string& to);
// A StreamMotionRequest.events entry with a Playhead; answered_seq as in ResumePoint.
void put_playhead(std::uint32_t session, std::uint64_t frame, std::uint64_t buffered_to, std::uint32_t underruns,
                  std::uint64_t answered_seq, std::string& to);
// A field of bytes: tag, length, content.
void put_bytes(std::uint32_t field, const std::string& content, std::string& to);

}  // namespace motiongen::wire
