// The vectors that this client and the one in Python are held to: tests/client/golden_vectors.py makes them.
#pragma once

#include <string>
#include <vector>

#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"

namespace motiongen::testing {

// A line: a name, words, and the numbers after the arrow.
struct GoldenLine {
  std::string name;
  std::vector<std::string> words;
  std::vector<float> expected;

  double number(std::size_t place) const { return std::stod(words.at(place)); }
  // The words from a place on.
  std::vector<float> numbers(std::size_t from) const;
};

// The lines of tests/data/client/NAME.txt; none where it cannot be read.
std::vector<GoldenLine> read_golden(const std::string& name);

// The chain of three joints that the vectors are about, perhaps with outputs; checked.
Rig golden_rig(std::vector<Block> outputs = {});

// Every number within 2e-5 of what is expected.
void expect_near(Span<const float> made, Span<const float> expected, const std::string& what);

}  // namespace motiongen::testing
