// How often this program has asked for memory.
#pragma once

#include <cstdint>

namespace motiongen::testing {

// Calls of operator new so far, of all threads.
std::uint64_t num_allocations();

}  // namespace motiongen::testing
