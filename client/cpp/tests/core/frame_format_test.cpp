#include "motiongen/core/frame_format.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <utility>

#include "core/golden.hpp"

namespace motiongen {
namespace {

class Bytes final : public RowSource {
 public:
  explicit Bytes(const std::string& hex) {
    for (std::size_t at = 0; at + 1 < hex.size(); at += 2) {
      bytes_.push_back(static_cast<char>(std::stoi(hex.substr(at, 2), nullptr, 16)));
    }
  }
  std::size_t num_bytes() const override { return bytes_.size() - taken_; }
  void take(std::size_t count, void* to) override {
    if (to != nullptr) std::memcpy(to, bytes_.data() + taken_, count);
    taken_ += count;
  }

 private:
  std::vector<char> bytes_;
  std::size_t taken_ = 0;
};

const std::vector<Block> kOutputs = {
    {"joint_positions_m", 9}, {"joint_global_rotation_quat_wxyz", 12}, {"joint_velocities_mps", 9}};

// One session of the vectors: a decoder and the previous row.
class Session {
 public:
  Session(FrameFormat format, std::vector<Block> outputs)
      : format_(format), rig_(testing::golden_rig(std::move(outputs))), decoder_(rig_, format) {}

  void take(const testing::GoldenLine& line) {
    Bytes bytes(line.words[1]);
    const auto count = static_cast<std::uint32_t>(line.number(0));
    EXPECT_EQ(bytes.num_bytes(), count * stored_row_bytes(rig_, format_)) << line.name;
    const std::vector<float> origin = line.numbers(2);
    ASSERT_TRUE(decoder_.begin(bytes, count, origin, before_)) << line.name;
    std::vector<float> rows(count * rig_.row_width);
    ASSERT_EQ(decoder_.num_bytes(), rows.size() * sizeof(float));
    decoder_.take(rows.size() * sizeof(float), rows.data());
    testing::expect_near(rows, line.expected, line.name);
    before_.assign(rows.end() - rig_.row_width, rows.end());
  }

 private:
  FrameFormat format_;
  Rig rig_;
  FrameDecoder decoder_;
  std::vector<float> before_;
};

TEST(FrameFormat, RowsEqualThoseOfThePythonClient) {
  std::vector<Block> with_robot = kOutputs;
  with_robot.push_back({"g1_qpos", 36});
  Session halves(FrameFormat::f16, {});
  Session quantised(FrameFormat::quantised, {});
  Session halves_outputs(FrameFormat::f16, with_robot);
  Session quantised_outputs(FrameFormat::quantised, kOutputs);
  const auto lines = testing::read_golden("frame_formats");
  ASSERT_EQ(lines.size(), 18U);
  for (const auto& line : lines) {
    Session& session = line.name == "f16"           ? halves
                       : line.name == "quantised"   ? quantised
                       : line.name == "f16_outputs" ? halves_outputs
                                                    : quantised_outputs;
    session.take(line);
  }
}

TEST(FrameFormat, ExtremeHalfFloatsAreReadExactly) {
  Rig rig = testing::golden_rig();
  FrameDecoder decoder(rig, FrameFormat::f16);
  const float origin[] = {0, 0, 0};
  // greatest, least normal and least half floats in the root's columns; -2, 1, 0 and -0 in the contacts
  const std::vector<float> expected = {65504, 6.103515625e-05F, 5.9604645e-08F, -2, 1, 0, 0};
  std::string hex = "ff7b00040100";
  for (int joint = 0; joint < 3; ++joint) hex += "003c000000000000";
  hex += "00c0003c00000080";
  Bytes bytes(hex);
  ASSERT_TRUE(decoder.begin(bytes, 1, {origin, 3}, {}));
  std::vector<float> row(rig.row_width);
  decoder.take(row.size() * sizeof(float), row.data());
  for (std::size_t place = 0; place < 3; ++place) EXPECT_EQ(row[place], expected[place]);
  for (std::size_t place = 0; place < 4; ++place) EXPECT_EQ(row[15 + place], expected[3 + place]);
}

TEST(FrameFormat, UncheckedRigIsNotWrittenPastItsRow) {
  Rig rig = testing::golden_rig();
  rig.outputs = {{"g1_qpos", 1}};
  rig.row_width = rig.own_width + 1;
  FrameDecoder decoder(rig, FrameFormat::f16);
  Bytes one_row(std::string(4 * rig.row_width, '0'));
  const float origin[] = {7, 8, 9};
  ASSERT_TRUE(decoder.begin(one_row, 1, {origin, 3}, {}));
  std::vector<float> row(rig.row_width + 2, 5);
  decoder.take(rig.row_width * sizeof(float), row.data());
  EXPECT_EQ(row[rig.own_width], 9) << "forward is z";
  EXPECT_EQ(row[rig.row_width], 5);
}

TEST(FrameFormat, MissingOriginOrWrongSizeIsRefused) {
  const Rig rig = testing::golden_rig();
  FrameDecoder decoder(rig, FrameFormat::f16);
  Bytes one_row(std::string(4 * rig.row_width, '0'));
  EXPECT_FALSE(decoder.begin(one_row, 1, {}, {})) << "no origin";
  const float origin[] = {0, 0, 0};
  EXPECT_FALSE(decoder.begin(one_row, 2, {origin, 3}, {}));
  EXPECT_EQ(decoder.num_bytes(), 0U);
  EXPECT_TRUE(decoder.begin(one_row, 1, {origin, 3}, {}));
}

}  // namespace
}  // namespace motiongen
