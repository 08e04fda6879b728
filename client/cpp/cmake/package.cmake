# Installing: libraries, headers, find_package(motiongen) and pkg-config.
include(CMakePackageConfigHelpers)

set(installed motiongen_core)
set(packages motiongen-core)
install(DIRECTORY include/motiongen/core DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/motiongen)
if(MOTIONGEN_CLIENT)
  list(APPEND installed motiongen_client motiongen_c)
  list(APPEND packages motiongen motiongen-c)
  install(DIRECTORY include/motiongen/client DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/motiongen)
  install(DIRECTORY include/motiongen/c DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/motiongen)
  install(FILES include/motiongen/motiongen.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/motiongen)
endif()
# found from where the file lies, so that an installed tree can be moved
file(RELATIVE_PATH up /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
foreach(package IN LISTS packages)
  configure_file(cmake/${package}.pc.in ${package}.pc @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/${package}.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()

install(TARGETS ${installed} EXPORT motiongen-targets
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(EXPORT motiongen-targets NAMESPACE motiongen:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
configure_package_config_file(cmake/motiongen-config.cmake.in motiongen-config.cmake
  INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
write_basic_package_version_file(motiongen-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/motiongen-config.cmake
  ${CMAKE_CURRENT_BINARY_DIR}/motiongen-config-version.cmake DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/motiongen)
