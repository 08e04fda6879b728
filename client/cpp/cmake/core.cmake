# motiongen_core: C++17 and the standard library, nothing else.
add_library(motiongen_core
  src/core/axes.cpp
  src/core/frame_format.cpp
  src/core/ground.cpp
  src/core/ground_follower.cpp
  src/core/ground_lifts.cpp
  src/core/pose.cpp
  src/core/retarget.cpp
  src/core/retarget_checks.cpp
  src/core/rig.cpp
  src/core/sampling.cpp
  src/core/status.cpp
  src/core/steering.cpp
  src/core/timeline.cpp
  src/core/timeline_clock.cpp)
add_library(motiongen::core ALIAS motiongen_core)
target_include_directories(motiongen_core
  PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
  PRIVATE src)
target_compile_features(motiongen_core PUBLIC cxx_std_17)
target_link_libraries(motiongen_core PRIVATE $<BUILD_INTERFACE:motiongen_library_flags>)
set_target_properties(motiongen_core PROPERTIES VERSION ${PROJECT_VERSION} SOVERSION 0 EXPORT_NAME core)
