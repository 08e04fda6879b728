#include "motiongen/core/frame_format.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "quaternion.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kPlaceBytes = 12;  // of a quantised root: three int32 of millimetres
constexpr std::size_t kTurnBytes = 4;    // of a quantised rotation
constexpr double kHalfRange = 511.5;
const double kScale = 511.0 * std::sqrt(2.0);

// IEEE 754 binary16.
float half(const std::uint8_t* from) {
  const std::uint32_t bits = static_cast<std::uint32_t>(from[0]) | static_cast<std::uint32_t>(from[1]) << 8;
  const std::uint32_t exponent = bits >> 10 & 31;
  const auto fraction = static_cast<float>(bits & 1023);
  float value = 0;
  if (exponent == 31) {
    value = fraction == 0 ? HUGE_VALF : NAN;
  } else if (exponent == 0) {
    value = std::ldexp(fraction, -24);
  } else {
    value = std::ldexp(1024 + fraction, static_cast<int>(exponent) - 25);
  }
  return (bits >> 15) != 0 ? -value : value;
}

std::uint32_t number(const std::uint8_t* from) {
  std::uint32_t value = 0;
  std::memcpy(&value, from, sizeof value);
  return value;
}

// The greatest of w, x, y, z follows from the three others, since the length is 1.
Quaternion unpacked(std::uint32_t packed) {
  const std::uint32_t greatest = packed >> 30;
  double values[4] = {0, 0, 0, 0};
  double squares = 0;
  int shift = 20;
  for (std::uint32_t place = 0; place < 4; ++place) {
    if (place == greatest) continue;
    values[place] = (static_cast<double>(packed >> shift & 1023) - kHalfRange) / kScale;
    squares += values[place] * values[place];
    shift -= 10;
  }
  values[greatest] = std::sqrt(std::max(1 - squares, 0.0));
  const double length = std::sqrt(squares + values[greatest] * values[greatest]);
  return {static_cast<float>(values[0] / length), static_cast<float>(values[1] / length),
          static_cast<float>(values[2] / length), static_cast<float>(values[3] / length)};
}

}  // namespace

std::size_t stored_row_bytes(const Rig& rig, FrameFormat format) {
  if (format == FrameFormat::quantised) return kPlaceBytes + kTurnBytes * rig.num_joints() + 1;
  return rig.row_width * std::size_t{format == FrameFormat::f16 ? 2U : 4U};
}

FrameDecoder::FrameDecoder(const Rig& rig, FrameFormat format)
    : rig_(rig), format_(format), bytes_(stored_row_bytes(rig, format)), row_(rig.row_width), before_(rig.row_width) {}

Status FrameDecoder::begin(RowSource& stored, std::uint32_t num_frames, Span<const float> origin_m,
                           Span<const float> before) {
  stored_ = nullptr;
  left_ = 0;
  if (num_frames < 1 || stored.num_bytes() != num_frames * bytes_.size()) {
    return violation("a chunk of " + std::to_string(num_frames) + " frames has " + std::to_string(stored.num_bytes()) +
                     " bytes, not the " + std::to_string(num_frames * bytes_.size()) + " of its rig");
  }
  if (format_ == FrameFormat::f16 && origin_m.size() != 3) {
    return violation("a chunk of halves has an origin of " + std::to_string(origin_m.size()) + " numbers, not 3");
  }
  if (format_ == FrameFormat::f16) std::copy(origin_m.begin(), origin_m.end(), origin_m_);
  has_before_ = before.size() == row_.size();
  if (has_before_) std::copy(before.begin(), before.end(), before_.begin());
  stored_ = &stored;
  left_ = num_frames;
  return {};
}

void FrameDecoder::take(std::size_t count, void* to) {
  const std::size_t row_bytes = row_.size() * sizeof(float);
  auto* out = static_cast<char*>(to);
  for (std::size_t taken = 0; taken + row_bytes <= count && left_ > 0; taken += row_bytes, --left_) {
    stored_->take(bytes_.size(), bytes_.data());
    if (format_ == FrameFormat::f32) std::memcpy(row_.data(), bytes_.data(), row_bytes);
    if (format_ == FrameFormat::f16) decode_halves();
    if (format_ == FrameFormat::quantised) decode_quantised();
    if (out != nullptr) std::memcpy(out + taken, row_.data(), row_bytes);
  }
}

void FrameDecoder::decode_halves() {
  for (std::size_t column = 0; column < row_.size(); ++column) row_[column] = half(&bytes_[2 * column]);
  for (std::size_t axis = 0; axis < 3; ++axis) row_[rig_.root_column + axis] += origin_m_[axis];
  for (std::size_t joint = 0; joint < rig_.num_joints(); ++joint) {
    float* turn = &row_[rig_.rotation_column + 4 * joint];
    store(normalized(load(turn), {1, 0, 0, 0}), turn);
  }
}

void FrameDecoder::decode_quantised() {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto millimetres = static_cast<std::int32_t>(number(&bytes_[4 * axis]));
    row_[rig_.root_column + axis] = static_cast<float>(millimetres / 1000.0);
  }
  for (std::size_t joint = 0; joint < rig_.num_joints(); ++joint) {
    const std::size_t column = rig_.rotation_column + 4 * joint;
    Quaternion turn = unpacked(number(&bytes_[kPlaceBytes + kTurnBytes * joint]));
    if (has_before_ && dot(turn, load(&before_[column])) < 0) turn = {-turn.w, -turn.x, -turn.y, -turn.z};
    store(turn, &row_[column]);
  }
  for (std::size_t foot = 0; foot < 4; ++foot) {
    row_[rig_.contact_column + foot] = static_cast<float>(bytes_.back() >> foot & 1);
  }
  std::copy(row_.begin(), row_.end(), before_.begin());
  has_before_ = true;
}

}  // namespace motiongen
