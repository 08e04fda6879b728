# Installing: libraries, headers, find_package(motiongen) and pkg-config.
include(CMakePackageConfigHelpers)

set(motiongen_installed motiongen_core)
install(DIRECTORY include/motiongen/core DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/motiongen)
configure_file(cmake/motiongen-core.pc.in motiongen-core.pc @ONLY)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/motiongen-core.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)

install(TARGETS ${motiongen_installed} EXPORT motiongen-targets
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(EXPORT motiongen-targets NAMESPACE motiongen:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
configure_package_config_file(cmake/motiongen-config.cmake.in motiongen-config.cmake
  INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
write_basic_package_version_file(motiongen-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/motiongen-config.cmake ${CMAKE_CURRENT_BINARY_DIR}/motiongen-config-version.cmake
  DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
