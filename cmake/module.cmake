# Flags that every target of ours gets; third-party headers are included as SYSTEM by their targets.
add_library(penumbra_options INTERFACE)
add_library(penumbra::options ALIAS penumbra_options)
set_target_properties(penumbra_options PROPERTIES EXPORT_NAME options)
target_compile_features(penumbra_options INTERFACE cxx_std_23)
# Clang's -Wshadow means parameters of friends that are named as a field, too.
set(penumbra_warnings -Wall -Wextra -Wpedantic $<$<CXX_COMPILER_ID:GNU>:-Wshadow>
    -Wnon-virtual-dtor -Wno-psabi)
if(NOT PENUMBRA_FUZZ)
  list(APPEND penumbra_warnings -Werror)
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  # False alarms of GCC 12 at -O2 and above: std::optional, std::expected; "x" + string; and what a
  # precompiled header makes of the standard library.
  list(APPEND penumbra_warnings -Wno-maybe-uninitialized -Wno-restrict -Wno-stringop-overflow
       -Wno-array-bounds -Wno-stringop-overread)
endif()
if(CMAKE_CXX_COMPILER_ID MATCHES Clang)
  # What std::stable_sort of GCC 12's library calls.
  list(APPEND penumbra_warnings -Wno-deprecated-declarations)
endif()
if(CMAKE_UNITY_BUILD)
  # GCC takes a file that is included in a unity file for a header, whose classes must not have
  # members of unnamed namespaces' types.
  list(APPEND penumbra_warnings $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
endif()
target_compile_options(penumbra_options INTERFACE "$<BUILD_INTERFACE:${penumbra_warnings}>")
# Clang fuses a * b + c where the instruction set can, GCC in ISO C++ does not. And it writes the time
# of headers into a precompiled one, with which ccache finds nothing for another clone. GCC collects
# garbage as soon as it has read a precompiled header: a twentieth of a build, for nothing.
if(CMAKE_CXX_COMPILER_ID MATCHES Clang)
  set(penumbra_compiler_options -ffp-contract=off "SHELL:-Xclang -fno-pch-timestamp")
elseif(CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  set(penumbra_compiler_options --param=ggc-min-heapsize=1048576)
endif()
# No one reads errno after a square root, and with it loops of them are not vectorised.
list(APPEND penumbra_compiler_options -fno-math-errno)
target_compile_options(penumbra_options INTERFACE "$<BUILD_INTERFACE:${penumbra_compiler_options}>")
# Programs include <penumbra/...>, and so do installed headers (install.cmake).
target_include_directories(penumbra_options INTERFACE
  $<BUILD_INTERFACE:${CMAKE_SOURCE_DIR}>
  $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
target_compile_definitions(penumbra_options INTERFACE SPDLOG_FMT_EXTERNAL)
if(PENUMBRA_SANITIZE)
  target_compile_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE}
                         -fno-omit-frame-pointer -fno-sanitize-recover=all)
  target_link_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE})
endif()
if(PENUMBRA_SANITIZE OR PENUMBRA_FUZZ)
  add_library(penumbra_sanitizers OBJECT ${CMAKE_SOURCE_DIR}/tests/support/sanitizers.cpp)
endif()
install(TARGETS penumbra_options EXPORT penumbra)

# The standard library is nine tenths of what each file parses: once for what must be fast, once for
# commands and tests, which are optimised little.
set(penumbra_quick_options $<$<CONFIG:Release>:-O1>)
set(penumbra_test_options ${penumbra_quick_options} $<$<BOOL:${PENUMBRA_FUZZ}>:-O0>)
function(penumbra_precompiled name)
  file(WRITE ${CMAKE_BINARY_DIR}/${name}.cpp.in "// Carries the precompiled header.\n")
  configure_file(${CMAKE_BINARY_DIR}/${name}.cpp.in ${CMAKE_BINARY_DIR}/${name}.cpp COPYONLY)
  add_library(${name} STATIC ${CMAKE_BINARY_DIR}/${name}.cpp)
  target_link_libraries(${name} PRIVATE penumbra_options glm::glm fmt::fmt ${ARGN})
  target_precompile_headers(${name} PRIVATE ${CMAKE_SOURCE_DIR}/cmake/precompiled.h)
endfunction()
penumbra_precompiled(penumbra_pch)
set_target_properties(penumbra_pch PROPERTIES POSITION_INDEPENDENT_CODE ON)
penumbra_precompiled(penumbra_quick_pch CLI11::CLI11 nlohmann_json::nlohmann_json)
target_compile_options(penumbra_quick_pch PRIVATE ${penumbra_quick_options})
target_precompile_headers(penumbra_quick_pch PRIVATE <CLI/CLI.hpp> <nlohmann/json.hpp>)
if(PENUMBRA_TESTS)
  penumbra_precompiled(penumbra_test_pch GTest::gtest GTest::gmock)
  target_compile_options(penumbra_test_pch PRIVATE ${penumbra_test_options})
  target_precompile_headers(penumbra_test_pch PRIVATE <gtest/gtest.h> <gmock/gmock.h>)
endif()

# Several files are compiled as one (CMAKE_UNITY_BUILD), but for kernels: Highway compiles those for
# each instruction set by including them again.
set(CMAKE_UNITY_BUILD_BATCH_SIZE 16)
function(penumbra_keep_apart)
  foreach(file IN LISTS ARGN)
    file(STRINGS ${file} kernel REGEX "hwy/foreach_target.h")
    if(kernel)
      set_source_files_properties(${file} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
endfunction()

# penumbra_module(NAME SOURCES ... PUBLIC ... PRIVATE ... [INTERNAL [QUICK]]): one folder, one library
# penumbra::NAME. It is installed unless it is INTERNAL; QUICK is built as programs are.
function(penumbra_module name)
  cmake_parse_arguments(ARG "INTERNAL;QUICK" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  penumbra_keep_apart(${ARG_SOURCES})
  add_library(penumbra_${name} STATIC ${ARG_SOURCES})
  add_library(penumbra::${name} ALIAS penumbra_${name})
  # Position independent: the archives may go into somebody's shared library.
  set_target_properties(penumbra_${name} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON)
  target_link_libraries(penumbra_${name} PUBLIC penumbra_options ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
  if(ARG_QUICK)
    set_target_properties(penumbra_${name} PROPERTIES POSITION_INDEPENDENT_CODE OFF)
    target_compile_options(penumbra_${name} PRIVATE ${penumbra_quick_options})
    target_precompile_headers(penumbra_${name} REUSE_FROM penumbra_quick_pch)
  else()
    target_precompile_headers(penumbra_${name} REUSE_FROM penumbra_pch)
  endif()
  if(NOT ARG_INTERNAL)
    install(TARGETS penumbra_${name} EXPORT penumbra COMPONENT dev)
    set_property(GLOBAL APPEND PROPERTY penumbra_rooms penumbra_${name})
  endif()
endfunction()

# penumbra_umbrella(NAME TARGETS...): what a room's inner rooms come to together.
function(penumbra_umbrella name)
  add_library(penumbra_${name} INTERFACE)
  add_library(penumbra::${name} ALIAS penumbra_${name})
  set_target_properties(penumbra_${name} PROPERTIES EXPORT_NAME ${name})
  target_link_libraries(penumbra_${name} INTERFACE ${ARGN})
  install(TARGETS penumbra_${name} EXPORT penumbra COMPONENT dev)
endfunction()

# penumbra_program(NAME SOURCES ... LINK ...): commands read options and print; optimising them takes
# a quarter of their compile time for nothing.
function(penumbra_program name)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE penumbra_options ${ARG_LINK})
  target_compile_options(${name} PRIVATE ${penumbra_quick_options})
  target_compile_definitions(${name} PRIVATE PENUMBRA_VERSION="${PROJECT_VERSION}")
  target_precompile_headers(${name} REUSE_FROM penumbra_quick_pch)
  if(TARGET penumbra_sanitizers)
    target_link_libraries(${name} PRIVATE penumbra_sanitizers)
  endif()
  install(TARGETS ${name} COMPONENT tools)
endfunction()

# penumbra_plots(NAME FILE.gp...): gnuplot scripts of module NAME as strings of "<folder>/plots.h":
# error_time.gp is kErrorTimePlot. A program carries its scripts and looks for none.
function(penumbra_plots name)
  set(text "// Made from the .gp files of this folder.\n#pragma once\n\nnamespace penumbra::tools {\n")
  foreach(file IN LISTS ARGN)
    file(READ ${file} script)
    string(REGEX REPLACE "\\.gp$" "" constant ${file})
    string(REPLACE "_" ";" words ${constant})
    set(constant k)
    foreach(word IN LISTS words)
      string(SUBSTRING ${word} 0 1 first)
      string(SUBSTRING ${word} 1 -1 others)
      string(TOUPPER ${first} first)
      string(APPEND constant ${first}${others})
    endforeach()
    string(APPEND text "inline constexpr const char* ${constant}Plot = R\"gp(${script})gp\";\n")
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/${file})
  endforeach()
  string(APPEND text "}  // namespace penumbra::tools\n")
  file(RELATIVE_PATH folder ${CMAKE_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/plots/${folder}/plots.h CONTENT "${text}" @ONLY)
  target_include_directories(penumbra_${name} PRIVATE ${CMAKE_BINARY_DIR}/plots)
endfunction()
