// Marks what the shared libraries export. Everything else in them is hidden.
#pragma once

#if defined(_WIN32)
#define MOTIONGEN_API  // static libraries there
#else
#define MOTIONGEN_API __attribute__((visibility("default")))
#endif
