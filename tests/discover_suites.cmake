# Writes CTEST_FILE, in which each suite of the GoogleTest program PROGRAM is one test of CTest: a
# program that loads two hundred libraries takes longer to start than most cases take to run. Cases
# that LEFT_OUT (a GoogleTest pattern) names are left out. What is baked is kept in BAKES.
execute_process(COMMAND ${PROGRAM} --gtest_list_tests --gtest_filter=*-${LEFT_OUT}
                OUTPUT_VARIABLE listed RESULT_VARIABLE result TIMEOUT 120)
if(NOT result EQUAL 0)
  message(FATAL_ERROR "${PROGRAM} --gtest_list_tests: ${result}")
endif()
string(REGEX MATCHALL "\n[A-Za-z0-9_/]+\\." suites "\n${listed}")
set(script)
foreach(line IN LISTS suites)
  string(REGEX MATCH "[A-Za-z0-9_/]+" suite "${line}")
  string(APPEND script "add_test([==[${suite}]==] [==[${PROGRAM}]==] [==[--gtest_filter=${suite}.*-${LEFT_OUT}]==])\n"
                       "set_tests_properties([==[${suite}]==] PROPERTIES LABELS unit PROCESSORS 2 FIXTURES_REQUIRED bakes\n"
                       "  ENVIRONMENT [==[PENUMBRA_TEST_BAKES=${BAKES}]==])\n")
endforeach()
file(WRITE ${CTEST_FILE} "${script}")
