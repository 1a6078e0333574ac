# What `cmake --install` puts where: headers under include/penumbra, archives, the package files for
# find_package() and pkg-config, the programs with their manual pages and bash completion.
include(CMakePackageConfigHelpers)

set(penumbra_header_rooms core codec calib capture lighting prt shadows compositor runtime)
install(DIRECTORY ${penumbra_header_rooms}
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/penumbra COMPONENT dev
        FILES_MATCHING PATTERN "*.h" PATTERN internal EXCLUDE
        # What rooms of one folder share among themselves: none of it can be seen in the shared
        # library.
        PATTERN sh_inpainting.h EXCLUDE PATTERN latlong_kernel.h EXCLUDE
        PATTERN calib/import EXCLUDE
        PATTERN capture/watch EXCLUDE PATTERN contradiction.h EXCLUDE
        PATTERN compositor/layers EXCLUDE PATTERN compositor/pixels EXCLUDE
        PATTERN compositor/projection.h EXCLUDE PATTERN compositor/view_lens.h EXCLUDE
        PATTERN compositor/foreground.h EXCLUDE PATTERN runtime/foreground EXCLUDE
        PATTERN runtime/studio EXCLUDE PATTERN runtime/surroundings EXCLUDE
        PATTERN runtime/direct EXCLUDE PATTERN runtime/governor EXCLUDE
        PATTERN runtime/scene/depth_mesh.h EXCLUDE
        REGEX "runtime/shading/(composite_stage|floor_recovery|free_transfer|mirrored_surroundings|object_memory)\\.h$" EXCLUDE
        REGEX "runtime/pipeline/(runner|stage_access|light_estimation_stage)\\.h$" EXCLUDE)
# Installed headers include each other as <penumbra/...>: a program may have a core/result.h too.
list(JOIN penumbra_header_rooms "|" penumbra_room)
install(CODE "
  file(GLOB_RECURSE headers
       \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_INCLUDEDIR}/penumbra/*.h\")
  foreach(header IN LISTS headers)
    file(READ \"\${header}\" text)
    string(REGEX REPLACE \"#include \\\"(${penumbra_room})/\" \"#include \\\"penumbra/\\\\1/\"
           text \"\${text}\")
    file(WRITE \"\${header}\" \"\${text}\")
  endforeach()" COMPONENT dev)

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

# The shared library: all rooms in one, of which only what public headers declare can be seen
# (`#pragma GCC visibility` in them). Whoever links it needs none of the libraries below.
get_property(penumbra_rooms GLOBAL PROPERTY penumbra_rooms)
list(TRANSFORM penumbra_rooms REPLACE "(.+)" "$<TARGET_OBJECTS:\\1>" OUTPUT_VARIABLE penumbra_objects)
add_library(penumbra_shared SHARED EXCLUDE_FROM_ALL ${penumbra_objects})
set_target_properties(penumbra_shared PROPERTIES OUTPUT_NAME penumbra VERSION ${PROJECT_VERSION}
  SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR} LINKER_LANGUAGE CXX)
target_link_libraries(penumbra_shared PRIVATE ${penumbra_rooms})
target_link_options(penumbra_shared PRIVATE
  -Wl,--version-script=${CMAKE_SOURCE_DIR}/cmake/exports.map -Wl,--no-undefined)
set_property(TARGET penumbra_shared APPEND PROPERTY LINK_DEPENDS ${CMAKE_SOURCE_DIR}/cmake/exports.map)
install(TARGETS penumbra_shared LIBRARY COMPONENT library NAMELINK_COMPONENT dev OPTIONAL)
configure_file(cmake/penumbra.pc.in penumbra.pc @ONLY)
# It names the shared library, so it goes where that goes.
install(CODE "if(EXISTS \"$<TARGET_FILE:penumbra_shared>\")
    file(INSTALL DESTINATION \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_LIBDIR}/pkgconfig\"
         TYPE FILE FILES \"${CMAKE_BINARY_DIR}/penumbra.pc\")
  endif()" COMPONENT dev)

# Manual pages and completion come from the same tables of options as --help.
set(manuals)
foreach(program penumbra penumbra-demo penumbra-calibrate penumbra-chart penumbrad)
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

# The daemon under systemd, and what watches it.
install(FILES service/systemd/penumbrad.service DESTINATION lib/systemd/system COMPONENT tools)
install(FILES service/systemd/penumbra.sysusers DESTINATION lib/sysusers.d RENAME penumbra.conf
        COMPONENT tools)
install(FILES service/systemd/rig.toml docs/examples/grafana.json docs/examples/alerts.yml
        DESTINATION ${CMAKE_INSTALL_DATADIR}/penumbra COMPONENT tools)

# cpack -G DEB: libpenumbra0.1 (the shared library), penumbra-dev (headers, archives, package files)
# and penumbra-tools (programs, which carry the rooms in themselves).
set(penumbra_library_package lib${PROJECT_NAME}${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
foreach(package ${penumbra_library_package}:library penumbra-dev:dev penumbra-tools:tools)
  string(REPLACE ":" ";" package ${package})
  list(GET package 0 name)
  list(GET package 1 component)
  install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${name} RENAME copyright
          COMPONENT ${component})
endforeach()
set(CPACK_PACKAGE_NAME penumbra)
set(CPACK_PACKAGE_CONTACT "The Penumbra project <penumbra@localhost>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "${PROJECT_DESCRIPTION}")
set(CPACK_GENERATOR DEB)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE zstd)  # smaller than gzip, and faster
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)  # and has the linker's cache renewed
set(CPACK_COMPONENTS_ALL library dev tools)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_NAME ${penumbra_library_package})
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SECTION libs)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_DEV_PACKAGE_NAME penumbra-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_TOOLS_PACKAGE_NAME penumbra-tools)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SECTION graphics)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SHLIBDEPS ON)
# Without a GPU the demo draws with Mesa's software device.
set(CPACK_DEBIAN_TOOLS_PACKAGE_DEPENDS "libegl-mesa0, libgl1-mesa-dri")
set(CPACK_DEBIAN_TOOLS_PACKAGE_RECOMMENDS "gnuplot-nox")
set(CPACK_DEBIAN_TOOLS_PACKAGE_CONTROL_EXTRA ${CMAKE_SOURCE_DIR}/service/systemd/postinst)
# Whoever builds against the archives needs the libraries' own headers.
file(STRINGS cmake/packages/build.txt penumbra_dev_packages REGEX "^lib.*-dev|^nlohmann")
list(JOIN penumbra_dev_packages ", " penumbra_dev_packages)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS
    "${penumbra_library_package} (= ${PROJECT_VERSION}), ${penumbra_dev_packages}")
include(CPack)
