# motiongen_c: one shared library with a C interface, for engines. What it is made of is linked in and hidden.
add_library(motiongen_c SHARED
  src/c/client.cpp src/c/clip.cpp src/c/engines.cpp src/c/ground.cpp src/c/session.cpp src/c/session_edits.cpp src/c/values.cpp)
add_library(motiongen::c ALIAS motiongen_c)
target_include_directories(motiongen_c
  PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
  PRIVATE src)
target_link_libraries(motiongen_c PRIVATE motiongen_client $<BUILD_INTERFACE:motiongen_library_flags>)
target_link_options(motiongen_c PRIVATE LINKER:--exclude-libs,ALL
  LINKER:--version-script=${CMAKE_CURRENT_SOURCE_DIR}/cmake/c.symbols)
set_target_properties(motiongen_c PROPERTIES LINK_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/cmake/c.symbols)
set_target_properties(motiongen_c PROPERTIES VERSION ${PROJECT_VERSION} SOVERSION 1 EXPORT_NAME c)
