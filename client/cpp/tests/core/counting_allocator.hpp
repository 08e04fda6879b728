// Counts this program's allocations.
#pragma once

#include <cstdint>

namespace motiongen::testing {

// Calls of operator new so far, in all threads.
std::uint64_t num_allocations();

}  // namespace motiongen::testing
