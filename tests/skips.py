#!/usr/bin/env python3
"""Names and counts the tests that were skipped; fails when one was skipped for an unexpected reason.

usage: skips.py EXPECTED_SKIPS CTEST_OUTPUT LAST_TEST_LOG SHARED_DATA_FOLDER
       skips.py EXPECTED_SKIPS GTEST_OUTPUT SHARED_DATA_FOLDER

CTest's output tells which tests were skipped, its log why; a GoogleTest program's own brief output
tells the source line and why. Expected reasons that end in "without the
shared data" count only where that folder is absent.
"""
import re
import sys
from collections import Counter
from pathlib import Path

SKIPPED = re.compile(r"Test\s+#\d+: (\S+) \.*\s*\*\*\*Skipped")
TEST = re.compile(r"^\d+/\d+ Test: (.+)$", re.MULTILINE)
# What GoogleTest prints: "FILE:LINE: Skipped" and the reason on the next line.
GTEST = re.compile(r"^(?P<where>\S+:\d+): Skipped\n(?P<why>.*)$", re.MULTILINE)
# What the Python tests and scripts print, a line for each reason.
SCRIPT = re.compile(r"^skipped: .*$", re.MULTILINE)


def reasons(log):
    """{test: reasons} of each that gave some."""
    found = {}
    starts = list(TEST.finditer(log))
    for start, end in zip(starts, starts[1:] + [None]):
        block = log[start.end():end.start() if end else len(log)]
        output = block.split("Output:", 1)[-1]
        if reason := GTEST.search(output):
            found[start[1]] = [reason["why"].strip()]
        elif several := SCRIPT.findall(output):
            found[start[1]] = list(dict.fromkeys(several))
    return found


def skipped(printed, log):
    """(test, reason) of each that CTest calls skipped."""
    why = reasons(log)
    return [(test, reason) for test in SKIPPED.findall(printed)
            for reason in why.get(test, ["no reason given"])]


def skipped_in_program(printed):
    """(source line, reason) of each that a GoogleTest program skipped."""
    return [(match["where"], match["why"].strip()) for match in GTEST.finditer(printed)]


def expected(text, with_shared_data):
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            reason, when = line.rsplit(" : ", 1)
            if not (with_shared_data and when.startswith("without the shared data")):
                yield re.compile(reason)


def self_test():
    printed = ("1/3 Test #1: A.B ....***Skipped 0.1 sec\n2/3 Test #2: C.D ....   Passed 0.1 sec\n"
               "3/3 Test #3: vm.x ...***Skipped 0.1 sec\n")
    log = ("1/3 Test: A.B\nOutput:\n---\nx.cpp:3: Skipped\nno such thing\n[  SKIPPED ] A.B\n"
           "2/3 Test: C.D\nOutput:\n---\n[       OK ] C.D\nTest Passed.\n"
           "3/3 Test: vm.x\nOutput:\n---\nOK (skipped=2)\nskipped: no kernel in x\n"
           "skipped: no data\nTest Passed.\n")
    if skipped(printed, log) != [("A.B", "no such thing"), ("vm.x", "skipped: no kernel in x"),
                                 ("vm.x", "skipped: no data")]:
        return f"self-test: does not see a skipped test: {skipped(printed, log)}"
    brief = "[==========] 2 tests\nx.cpp:3: Skipped\nno such thing\n\n[  PASSED  ] 1 test.\n"
    if skipped_in_program(brief) != [("x.cpp:3", "no such thing")]:
        return f"self-test: does not see a skip in a program: {skipped_in_program(brief)}"
    known = "a reason : without the shared data; x\n"
    if list(expected(known, True)) or not list(expected(known, False)):
        return "self-test: does not tell when a reason counts"
    return None


def main(list_file, *outputs, shared):
    if fault := self_test():
        print(fault, file=sys.stderr)
        return 1
    allowed = list(expected(Path(list_file).read_text(encoding="utf-8"), Path(shared).is_dir()))
    read = [Path(f).read_text(encoding="utf-8", errors="replace") for f in outputs]
    found = skipped(*read) if len(read) == 2 else skipped_in_program(*read)
    for reason, count in Counter(reason for _, reason in found).most_common():
        print(f"skipped {count}: {reason}")
    wrong = [(test, reason) for test, reason in found if not any(p.search(reason) for p in allowed)]
    for test, reason in wrong:
        print(f"unexpected skip: {test}: {reason}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:-1], shared=sys.argv[-1]))
