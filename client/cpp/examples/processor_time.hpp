// Processor time of this process, for programs that measure themselves.
#pragma once

#include <sys/resource.h>

// Seconds so far, all threads together.
inline double processor_time_s() {
  rusage used{};
  getrusage(RUSAGE_SELF, &used);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
  };
  return seconds(used.ru_utime) + seconds(used.ru_stime);
}
