# Flags that every target of ours gets; third-party headers are included as SYSTEM by their targets.
add_library(penumbra_options INTERFACE)
target_compile_options(penumbra_options INTERFACE -Wall -Wextra -Wpedantic $<$<NOT:$<BOOL:${PENUMBRA_FUZZ}>>:-Werror> -Wshadow
                       -Wnon-virtual-dtor -Wno-psabi
                       # False alarms of GCC 12 at -O2 and above: std::optional, std::expected; "x" + string;
                       # and what a precompiled header makes of the standard library.
                       $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized -Wno-restrict -Wno-stringop-overflow
                       -Wno-array-bounds -Wno-stringop-overread>)
target_include_directories(penumbra_options INTERFACE $<BUILD_INTERFACE:${CMAKE_SOURCE_DIR}>)
target_compile_definitions(penumbra_options INTERFACE SPDLOG_FMT_EXTERNAL)
if(PENUMBRA_SANITIZE)
  target_compile_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE}
                         -fno-omit-frame-pointer -fno-sanitize-recover=all)
  target_link_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE})
  add_library(penumbra_sanitizers OBJECT ${CMAKE_SOURCE_DIR}/tests/support/sanitizers.cpp)
endif()

# The standard library is nine tenths of what each file parses: once for what must be fast, once for
# commands and tests, which are optimised little.
set(penumbra_quick_options $<$<CONFIG:Release>:-O1>)
function(penumbra_precompiled name)
  file(WRITE ${CMAKE_BINARY_DIR}/${name}.cpp.in "// Carries the precompiled header.\n")
  configure_file(${CMAKE_BINARY_DIR}/${name}.cpp.in ${CMAKE_BINARY_DIR}/${name}.cpp COPYONLY)
  add_library(${name} STATIC ${CMAKE_BINARY_DIR}/${name}.cpp)
  target_link_libraries(${name} PRIVATE penumbra_options glm::glm fmt::fmt ${ARGN})
  target_precompile_headers(${name} PRIVATE ${CMAKE_SOURCE_DIR}/cmake/precompiled.h)
endfunction()
penumbra_precompiled(penumbra_pch)
penumbra_precompiled(penumbra_quick_pch)
target_compile_options(penumbra_quick_pch PRIVATE ${penumbra_quick_options})

# penumbra_module(NAME SOURCES ... PUBLIC ... PRIVATE ...): one folder, one library penumbra::NAME.
function(penumbra_module name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(penumbra_${name} STATIC ${ARG_SOURCES})
  add_library(penumbra::${name} ALIAS penumbra_${name})
  target_link_libraries(penumbra_${name} PUBLIC penumbra_options ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
  target_precompile_headers(penumbra_${name} REUSE_FROM penumbra_pch)
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
  if(PENUMBRA_SANITIZE)
    target_link_libraries(${name} PRIVATE penumbra_sanitizers)
  endif()
endfunction()
