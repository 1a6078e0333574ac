#!/usr/bin/env python3
"""Counts the tests that passed and failed, and names those that were skipped; fails when one was
skipped for an unexpected reason.

usage: report.py [--all] EXPECTED_SKIPS CTEST_OUTPUT LAST_TEST_LOG SHARED_DATA_FOLDER
       report.py EXPECTED_SKIPS GTEST_OUTPUT SHARED_DATA_FOLDER

CTest's output tells how tests ended, its log what they printed: one of them may be a suite of
GoogleTest, whose cases are counted; the last line is "N passed, N failed". A GoogleTest program's own
brief output tells skipped tests alone. Expected reasons count always, or "without the shared data"
only where that folder is absent, or "without --all" only where that is not given.
"""
import re
import sys
from collections import Counter
from pathlib import Path

# What CTest prints as each test ends, and how its log begins what the test printed.
ENDED = re.compile(r"^ *\d+/\d+ Test +#\d+: (?P<test>.+?) \.+ *(?P<how>Passed|\*\*\*\w.*?) +[\d.]+ sec *$",
                   re.MULTILINE)
TEST = re.compile(r"^\d+/\d+ Test: (.+)$", re.MULTILINE)
CASE = re.compile(r"^\[ +(?P<end>OK|FAILED|SKIPPED) +\] \S+\.\S+.* \(\d+ ms\)$", re.MULTILINE)
# What GoogleTest prints: "FILE:LINE: Skipped" and the reason on the next line.
GTEST = re.compile(r"^(?P<where>\S+:\d+): Skipped\n(?P<why>.*)$", re.MULTILINE)
# What the Python tests and scripts print, a line for each reason.
SCRIPT = re.compile(r"^skipped: .*$", re.MULTILINE)


def outputs(log):
    """{test: what it printed}, from CTest's log."""
    starts = list(TEST.finditer(log))
    return {start[1]: log[start.end():end.start() if end else len(log)].split("Output:", 1)[-1]
            for start, end in zip(starts, starts[1:] + [None])}


def tally(how, output):
    """Counter of passed, failed and skipped cases of one test, which ended as CTest says."""
    cases = Counter(match["end"] for match in CASE.finditer(output))
    counts = Counter(passed=cases["OK"], failed=cases["FAILED"], skipped=cases["SKIPPED"])
    if how == "***Skipped":
        counts["skipped"] = max(1, counts["skipped"])
    elif how != "Passed":
        counts["failed"] = max(1, counts["failed"])  # a crash or a time limit fails no case
    elif not cases:
        counts["passed"] = 1
    return counts


def read_run(printed, log):
    """Counter of all cases, and (test, reason) of each that was skipped."""
    said = outputs(log)
    counts, skips = Counter(), []
    for end in ENDED.finditer(printed):
        output = said.get(end["test"], "")
        one = tally(end["how"], output)
        why = [match["why"].strip() for match in GTEST.finditer(output)]
        if end["how"] == "***Skipped":
            why += dict.fromkeys(SCRIPT.findall(output))
        skips += [(end["test"], reason) for reason in why or ["no reason given"] * one["skipped"]]
        counts += one
    return counts, skips


def skipped_in_program(printed):
    """(source line, reason) of each that a GoogleTest program skipped."""
    return [(match["where"], match["why"].strip()) for match in GTEST.finditer(printed)]


def expected(text, with_shared_data, with_all_packages=False):
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            reason, when = line.rsplit(" : ", 1)
            if not (with_shared_data and when.startswith("without the shared data")
                    or with_all_packages and when.startswith("without --all")):
                yield re.compile(reason)


def self_test():
    printed = ("1/6 Test #1: A ....   Passed    0.1 sec\n2/6 Test #2: C.D/x  # GetParam() = x ...   Passed    0.10 sec\n"
               "3/6 Test #3: vm.x ...***Skipped 0.1 sec\n4/6 Test #4: E ...***Failed   0.10 sec\n"
               "5/6 Test #5: F ..***Exception: SegFault  0.00 sec\n 6/6 Test #6: none ..***Not Run   0.00 sec\n")
    log = ("1/6 Test: A\nOutput:\n---\nx.cpp:3: Skipped\nno such thing\n[  SKIPPED ] A.B (0 ms)\n"
           "[       OK ] A.C (3 ms)\n[  SKIPPED ] A.B\nTest Passed.\n"
           "2/6 Test: C.D/x  # GetParam() = x\nOutput:\n---\n[       OK ] C.D/0 (1 ms)\nTest Passed.\n"
           "3/6 Test: vm.x\nOutput:\n---\nOK (skipped=2)\nskipped: no kernel in x\nskipped: no data\nTest Passed.\n"
           "4/6 Test: E\nOutput:\n---\n[  FAILED  ] E.A, where GetParam() = 3 (1 ms)\n[       OK ] E.B (1 ms)\n"
           "[  FAILED  ] E.C (1 ms)\n[  FAILED  ] E.A\n[  FAILED  ] E.C\nTest Failed.\n"
           "5/6 Test: F\nOutput:\n---\n[ RUN      ] F.A\nTest Failed.\n")
    counts, skips = read_run(printed, log)
    if (counts["passed"], counts["failed"], counts["skipped"]) != (3, 4, 2):
        return f"self-test: counts wrongly: {counts}"
    if skips != [("A", "no such thing"), ("vm.x", "skipped: no kernel in x"), ("vm.x", "skipped: no data")]:
        return f"self-test: does not see a skipped test: {skips}"
    brief = "[==========] 2 tests\nx.cpp:3: Skipped\nno such thing\n\n[  PASSED  ] 1 test.\n"
    if skipped_in_program(brief) != [("x.cpp:3", "no such thing")]:
        return f"self-test: does not see a skip in a program: {skipped_in_program(brief)}"
    known = "a reason : without the shared data; x\n"
    if list(expected(known, True)) or not list(expected(known, False)):
        return "self-test: does not tell when a reason counts"
    known = "a reason : without --all, x\n"
    if list(expected(known, True, True)) or not list(expected(known, True, False)):
        return "self-test: does not tell with which packages a reason counts"
    return None


def main(list_file, *files, shared, with_all_packages):
    if fault := self_test():
        print(fault, file=sys.stderr)
        return 1
    allowed = list(expected(Path(list_file).read_text(encoding="utf-8"), Path(shared).is_dir(), with_all_packages))
    read = [Path(f).read_text(encoding="utf-8", errors="replace") for f in files]
    counts, skips = read_run(*read) if len(read) == 2 else (None, skipped_in_program(*read))
    for reason, count in Counter(reason for _, reason in skips).most_common():
        print(f"skipped {count}: {reason}")
    wrong = [(test, reason) for test, reason in skips if not any(p.search(reason) for p in allowed)]
    for test, reason in wrong:
        print(f"unexpected skip: {test}: {reason}", file=sys.stderr)
    if counts is None:
        return 1 if wrong else 0
    if not counts:
        print("no test ran", file=sys.stderr)
    print(f"{counts['passed']} passed, {counts['failed']} failed")
    return 1 if wrong or counts["failed"] or not counts else 0


if __name__ == "__main__":
    given = [argument for argument in sys.argv[1:] if argument != "--all"]
    if len(given) not in (3, 4):
        sys.exit(__doc__)
    sys.exit(main(*given[:-1], shared=given[-1], with_all_packages="--all" in sys.argv))
