# What `cmake --install` puts where: headers under include/penumbra, archives, the package files for
# find_package() and pkg-config, the programs with their manual pages and bash completion.
include(CMakePackageConfigHelpers)

install(DIRECTORY core codec calib capture lighting prt shadows compositor runtime
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/penumbra COMPONENT dev
        FILES_MATCHING PATTERN "*.h" PATTERN internal EXCLUDE PATTERN studio_setup.h EXCLUDE
        PATTERN real_mesh_world.h EXCLUDE)

set(penumbra_package ${CMAKE_INSTALL_LIBDIR}/cmake/penumbra)
install(EXPORT penumbra NAMESPACE penumbra:: FILE penumbraTargets.cmake
        DESTINATION ${penumbra_package} COMPONENT dev)
configure_package_config_file(cmake/penumbraConfig.cmake.in penumbraConfig.cmake
                              INSTALL_DESTINATION ${penumbra_package})
write_basic_package_version_file(penumbraConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/penumbraConfig.cmake ${CMAKE_BINARY_DIR}/penumbraConfigVersion.cmake
        DESTINATION ${penumbra_package} COMPONENT dev)
# pkg-config serves the light alone, which needs no other library of weight.
file(RELATIVE_PATH penumbra_pc_prefix /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
configure_file(cmake/penumbra-lighting.pc.in penumbra-lighting.pc @ONLY)
install(FILES ${CMAKE_BINARY_DIR}/penumbra-lighting.pc
        DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT dev)

# Manual pages and completion come from the same tables of options as --help.
set(manuals)
foreach(program penumbra penumbra-calibrate penumbra-chart)
  add_custom_command(OUTPUT ${program}.1 ${program}.bash
    COMMAND ${program} --print-manual > ${program}.1
    COMMAND ${program} --print-completion > ${program}.bash
    DEPENDS ${program} VERBATIM)
  list(APPEND manuals ${program}.1 ${program}.bash)
  install(FILES ${CMAKE_BINARY_DIR}/${program}.1 DESTINATION ${CMAKE_INSTALL_MANDIR}/man1
          COMPONENT tools)
  install(FILES ${CMAKE_BINARY_DIR}/${program}.bash
          DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions RENAME ${program}
          COMPONENT tools)
endforeach()
add_custom_target(manuals ALL DEPENDS ${manuals})

# cpack -G DEB: penumbra-dev (archives and headers) and penumbra-tools (programs).
set(CPACK_PACKAGE_NAME penumbra)
set(CPACK_PACKAGE_CONTACT "The Penumbra project")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "${PROJECT_DESCRIPTION}")
set(CPACK_GENERATOR DEB)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_ALL dev tools)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_DEV_PACKAGE_NAME penumbra-dev)
set(CPACK_DEBIAN_TOOLS_PACKAGE_NAME penumbra-tools)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SHLIBDEPS ON)
# Whoever builds against the archives needs the libraries' own headers.
file(STRINGS cmake/packages/build.txt penumbra_dev_packages REGEX "^lib.*-dev|^nlohmann")
list(JOIN penumbra_dev_packages ", " penumbra_dev_packages)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS "${penumbra_dev_packages}")
include(CPack)
