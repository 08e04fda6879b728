#include "core/golden.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>
#include <utility>

namespace motiongen::testing {

std::vector<float> GoldenLine::numbers(std::size_t from) const {
  std::vector<float> found;
  for (std::size_t place = from; place < words.size(); ++place) found.push_back(std::stof(words[place]));
  return found;
}

std::vector<GoldenLine> read_golden(const std::string& name) {
  std::ifstream file(std::string(MOTIONGEN_GOLDEN) + "/" + name + ".txt");
  std::vector<GoldenLine> lines;
  for (std::string text; std::getline(file, text);) {
    std::istringstream in(text);
    GoldenLine line;
    in >> line.name;
    bool is_expected = false;
    for (std::string word; in >> word;) {
      if (word == "->") {
        is_expected = true;
      } else if (is_expected) {
        line.expected.push_back(std::stof(word));
      } else {
        line.words.push_back(word);
      }
    }
    lines.push_back(line);
  }
  return lines;
}

Rig golden_rig(std::vector<Block> outputs) {
  Rig rig;
  rig.rig_id = "chain";
  rig.joint_names = {"root", "middle", "end"};
  rig.parents = {-1, 0, 1};
  rig.offsets_m = {0, 0, 0, 0, 1, 0, 0, 1, 0};
  rig.frame_rate_hz = 20;
  rig.blocks = {{"root_translation_m", 3}, {"joint_rotation_quat_wxyz", 12}, {"foot_contact", 4}};
  rig.outputs = std::move(outputs);
  EXPECT_TRUE(rig.check());
  return rig;
}

void expect_near(Span<const float> made, Span<const float> expected, const std::string& what) {
  ASSERT_EQ(made.size(), expected.size()) << what;
  for (std::size_t place = 0; place < made.size(); ++place) {
    EXPECT_NEAR(made[place], expected[place], 2e-5) << what << ", number " << place;
  }
}

}  // namespace motiongen::testing
