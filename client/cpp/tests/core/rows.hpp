// Rows and rigs for tests.
#pragma once

#include <cstdint>
#include <vector>

#include "motiongen/core/rig.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen::testing {

// A rig that is a chain of three joints, each 1 m above the one before; checked.
Rig chain_rig();

// A row of the chain: the root at (x, 0, 0), every rotation the identity.
std::vector<float> chain_row(const Rig& rig, float x);

// num_frames rows of `width` numbers; each number of a row is plan * 1000 + its frame.
std::vector<float> numbered_rows(std::uint32_t plan, std::uint64_t first_frame, std::uint32_t num_frames,
                                 std::uint32_t width);

// A timeline with rows of two numbers at 20 frames a second.
Timeline small_timeline(std::uint32_t keep_frames = 100);

// Add frames of a plan to a timeline, committed up to `committed_to`.
Status add(Timeline& timeline, std::uint32_t plan, std::uint64_t first_frame, std::uint32_t num_frames,
           std::uint64_t committed_to = 0);

}  // namespace motiongen::testing
