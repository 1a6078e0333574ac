# Flags that every target of ours gets; third-party headers are included as SYSTEM by their targets.
add_library(penumbra_options INTERFACE)
target_compile_options(penumbra_options INTERFACE -Wall -Wextra -Wpedantic $<$<NOT:$<BOOL:${PENUMBRA_FUZZ}>>:-Werror> -Wshadow
                       -Wnon-virtual-dtor -Wno-psabi
                       # False alarms of GCC 12 at -O2 and above: std::optional, std::expected; "x" + string.
                       $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized -Wno-restrict>)
target_include_directories(penumbra_options INTERFACE ${CMAKE_SOURCE_DIR})
if(PENUMBRA_SANITIZE)
  target_compile_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE}
                         -fno-omit-frame-pointer -fno-sanitize-recover=all)
  target_link_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE})
  add_library(penumbra_sanitizers OBJECT ${CMAKE_SOURCE_DIR}/tests/support/sanitizers.cpp)
endif()

# penumbra_module(NAME SOURCES ... PUBLIC ... PRIVATE ...): one folder, one library penumbra::NAME.
function(penumbra_module name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(penumbra_${name} STATIC ${ARG_SOURCES})
  add_library(penumbra::${name} ALIAS penumbra_${name})
  target_link_libraries(penumbra_${name} PUBLIC penumbra_options ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
endfunction()
