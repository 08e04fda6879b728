// The vectors that this client and the Python client must both reproduce; tests/client/golden_vectors.py makes them.
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
  // The words from an index on, as numbers.
  std::vector<float> numbers(std::size_t from) const;
};

// The lines of tests/data/client/NAME.txt; none if it cannot be read.
std::vector<GoldenLine> read_golden(const std::string& name);

// The vectors' rig, a chain of three joints, with outputs if given; checked.
Rig golden_rig(std::vector<Block> outputs = {});

// Expect every number to be within 2e-5 of its expected value.
void expect_near(Span<const float> made, Span<const float> expected, const std::string& what);

}  // namespace motiongen::testing
