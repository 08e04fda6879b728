#include "client/wire.hpp"

#include <algorithm>
#include <cstring>

namespace motiongen::wire {
namespace {

// Field numbers of session.proto and motion.proto; a test compares them with the generated code.
constexpr std::uint32_t kSession = 1;
constexpr std::uint32_t kAppliedSeq = 2;
constexpr std::uint32_t kUpdateFirst = 10;
constexpr std::uint32_t kUpdateLast = 18;
constexpr std::uint32_t kUpdateChunk = 11;
constexpr std::uint32_t kUpdatePlan = 12;
constexpr std::uint32_t kEvents = 1;
constexpr std::uint32_t kPlayhead = 15;

constexpr std::uint32_t kRootOrigin = 7;
constexpr std::uint64_t kCauseCut = 7;

constexpr std::uint64_t kMost32 = 0xFFFFFFFF;

// FrameChunk.root_origin_m, packed or not.
bool read_origin(Cursor& cursor, std::uint32_t type, Chunk& chunk) {
  Cursor numbers = cursor;
  if (type == kLength ? !cursor.read_message(numbers) : !cursor.skip(sizeof(float))) return false;
  std::size_t left = type == kLength ? numbers.left() : sizeof(float);
  for (; left >= sizeof(float); left -= sizeof(float)) {
    float value = 0;
    if (!numbers.copy(sizeof value, &value)) return false;
    if (chunk.num_origin < 3) chunk.origin_m[chunk.num_origin] = value;
    if (chunk.num_origin < 4) ++chunk.num_origin;
  }
  return left == 0;
}

}  // namespace

bool Cursor::copy(std::size_t count, void* to) {
  if (count > left_) return false;
  left_ -= count;
  auto* out = static_cast<std::uint8_t*>(to);
  while (count > 0) {
    while (at_ == piece_->size) {
      ++piece_;
      at_ = 0;
    }
    const std::size_t here = std::min(count, piece_->size - at_);
    if (out != nullptr) {
      std::memcpy(out, piece_->data + at_, here);
      out += here;
    }
    at_ += here;
    count -= here;
  }
  return true;
}

bool Cursor::read_varint(std::uint64_t& value) {
  value = 0;
  for (unsigned shift = 0; shift < 64; shift += 7) {
    std::uint8_t byte = 0;
    if (!copy(1, &byte)) return false;
    value |= static_cast<std::uint64_t>(byte & 0x7FU) << shift;
    if (byte < 0x80) return true;
  }
  return false;
}

bool Cursor::read_message(Cursor& inner) {
  std::uint64_t size = 0;
  if (!read_varint(size) || size > left_) return false;
  inner = *this;
  inner.left_ = size;
  return skip(size);
}

bool Cursor::read_tag(std::uint32_t& field, std::uint32_t& type) {
  std::uint64_t tag = 0;
  if (!read_varint(tag) || tag > kMost32 || tag >> 3 == 0) return false;
  field = static_cast<std::uint32_t>(tag >> 3);
  type = static_cast<std::uint32_t>(tag & 7);
  return true;
}

bool Cursor::skip_value(std::uint32_t type) {
  std::uint64_t ignored = 0;
  Cursor inner;
  switch (type) {
    case kVarint:
      return read_varint(ignored);
    case kFixed64:
      return skip(8);
    case kLength:
      return read_message(inner);
    case kFixed32:
      return skip(4);
    default:
      return false;
  }
}

bool read_update(Cursor cursor, Update& update) {
  update = Update();
  update.all = cursor;
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  while (cursor.left() > 0) {
    if (!cursor.read_tag(field, type)) return false;
    std::uint64_t value = 0;
    if (type == kVarint && (field == kSession || field == kAppliedSeq)) {
      if (!cursor.read_varint(value)) return false;
      if (field == kSession) update.session = static_cast<std::uint32_t>(value);
      if (field == kAppliedSeq) update.applied_seq = value;
    } else if (type == kLength && field >= kUpdateFirst && field <= kUpdateLast) {
      if (!cursor.read_message(update.body)) return false;
      update.kind = field == kUpdateChunk  ? Update::Kind::chunk
                    : field == kUpdatePlan ? Update::Kind::plan
                                           : Update::Kind::other;
    } else if (!cursor.skip_value(type)) {
      return false;
    }
  }
  return true;
}

bool read_chunk(Cursor cursor, Chunk& chunk) {
  chunk = Chunk();
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  while (cursor.left() > 0) {
    if (!cursor.read_tag(field, type)) return false;
    std::uint64_t value = 0;
    if (type == kLength && field == 5) {
      if (!cursor.read_message(chunk.data)) return false;
    } else if (field == kRootOrigin && (type == kLength || type == kFixed32)) {
      if (!read_origin(cursor, type, chunk)) return false;
    } else if (type == kVarint) {
      if (!cursor.read_varint(value)) return false;
      if (field == 1) chunk.header.plan = static_cast<std::uint32_t>(value);
      if (field == 2) chunk.header.first_frame = value;
      if (field == 3) chunk.header.num_frames = static_cast<std::uint32_t>(value);
      if (field == 4) chunk.header.committed_to = value;
      if (field == 6) chunk.scalar_type = value;
    } else if (!cursor.skip_value(type)) {
      return false;
    }
  }
  return true;
}

bool read_plan(Cursor cursor, Plan& plan) {
  plan = Plan();
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  while (cursor.left() > 0) {
    if (!cursor.read_tag(field, type)) return false;
    std::uint64_t value = 0;
    if (type == kVarint) {
      if (!cursor.read_varint(value)) return false;
      if (field == 1) plan.plan = static_cast<std::uint32_t>(value);
      if (field == 2) plan.valid_from = value;
      if (field == 3) plan.is_cut = value == kCauseCut;
    } else if (!cursor.skip_value(type)) {
      return false;
    }
  }
  return true;
}

bool gather(Cursor cursor, std::string& to) {
  to.resize(cursor.left());
  return cursor.copy(cursor.left(), to.data());
}

void put_varint(std::uint64_t value, std::string& to) {
  while (value >= 0x80) {
    to.push_back(static_cast<char>(value | 0x80));
    value >>= 7;
  }
  to.push_back(static_cast<char>(value));
}

void put_bytes(std::uint32_t field, const std::string& content, std::string& to) {
  put_varint(field << 3 | kLength, to);
  put_varint(content.size(), to);
  to += content;
}

void put_playhead(std::uint32_t session, std::uint64_t frame, std::uint64_t buffered_to, std::uint32_t underruns,
                  std::uint64_t answered_seq, std::string& to) {
  // a report is so short that each length takes one byte, which is filled in afterwards
  put_varint(kEvents << 3 | kLength, to);
  const std::size_t event = to.size();
  to.push_back(0);
  put_varint(kSession << 3, to);
  put_varint(session, to);
  put_varint(kPlayhead << 3 | kLength, to);
  const std::size_t playhead = to.size();
  to.push_back(0);
  put_varint(1 << 3, to);
  put_varint(frame, to);
  put_varint(2 << 3, to);
  put_varint(buffered_to, to);
  put_varint(3 << 3, to);
  put_varint(underruns, to);
  put_varint(4 << 3, to);
  put_varint(answered_seq, to);
  to[playhead] = static_cast<char>(to.size() - playhead - 1);
  to[event] = static_cast<char>(to.size() - event - 1);
}

}  // namespace motiongen::wire
