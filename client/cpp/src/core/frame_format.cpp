#include "motiongen/core/frame_format.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "quaternion.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kPlaceBytes = 12;  // a quantised root: three int32 of millimetres
constexpr std::size_t kTurnBytes = 4;    // a quantised rotation
constexpr char kPositions[] = "joint_positions_m";
constexpr char kGlobalRotations[] = "joint_global_rotation_quat_wxyz";
constexpr char kRobotPose[] = "g1_qpos";
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

// Four numbers of a rotation take four bytes, any other number two.
std::size_t quantised_bytes(const Block& output) {
  return output.name == kGlobalRotations ? output.width : 2 * std::size_t{output.width};
}

// The greatest of w, x, y, z follows from the other three, since the length is 1.
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
  if (format == FrameFormat::quantised) {
    std::size_t bytes = kPlaceBytes + kTurnBytes * rig.num_joints() + 1;
    for (const Block& output : rig.outputs) bytes += quantised_bytes(output);
    return bytes;
  }
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
  std::size_t column = rig_.own_width;
  for (const Block& output : rig_.outputs) {
    const std::size_t wanted = output.name == kPositions ? output.width : output.name == kRobotPose ? 3 : 0;
    const std::size_t places = std::min<std::size_t>(wanted, output.width);  // the rig may be unchecked
    // forward, left and up of the robot are our z, x and y
    const std::size_t turned = output.name == kRobotPose ? 2 : 0;
    for (std::size_t place = 0; place < places; ++place) row_[column + place] += origin_m_[(place + turned) % 3];
    column += output.width;
  }
}

void FrameDecoder::decode_quantised() {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto millimetres = static_cast<std::int32_t>(number(&bytes_[4 * axis]));
    row_[rig_.root_column + axis] = static_cast<float>(millimetres / 1000.0);
  }
  decode_rotations(rig_.rotation_column, rig_.num_joints(), &bytes_[kPlaceBytes]);
  std::size_t at = kPlaceBytes + kTurnBytes * rig_.num_joints();
  for (std::size_t foot = 0; foot < 4; ++foot) {
    row_[rig_.contact_column + foot] = static_cast<float>(bytes_[at] >> foot & 1);
  }
  ++at;
  std::size_t column = rig_.own_width;
  for (const Block& output : rig_.outputs) {
    decode_output(output, column, &bytes_[at]);
    column += output.width;
    at += quantised_bytes(output);
  }
  std::copy(row_.begin(), row_.end(), before_.begin());
  has_before_ = true;
}

void FrameDecoder::decode_output(const Block& output, std::size_t column, const std::uint8_t* from) {
  if (output.name == kGlobalRotations) return decode_rotations(column, output.width / 4, from);
  const bool is_place = output.name == kPositions;
  for (std::size_t value = 0; value < output.width; ++value) {
    std::int16_t thousandths = 0;
    std::memcpy(&thousandths, from + 2 * value, sizeof thousandths);
    const float seen_from = is_place ? row_[rig_.root_column + value % 3] : 0;
    row_[column + value] = static_cast<float>(thousandths) / 1000 + seen_from;
  }
}

void FrameDecoder::decode_rotations(std::size_t column, std::size_t count, const std::uint8_t* from) {
  for (std::size_t turn = 0; turn < count; ++turn, column += 4) {
    Quaternion read = unpacked(number(from + kTurnBytes * turn));
    if (has_before_ && dot(read, load(&before_[column])) < 0) read = {-read.w, -read.x, -read.y, -read.z};
    store(read, &row_[column]);
  }
}

}  // namespace motiongen
