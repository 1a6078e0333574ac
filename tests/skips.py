#!/usr/bin/env python3
"""Names and counts the tests that were skipped; fails when one was skipped for an unexpected reason.

usage: skips.py EXPECTED_SKIPS LAST_TEST_LOG SHARED_DATA_FOLDER

Expected reasons that end in "without the shared data" count only where that folder is absent.
"""
import re
import sys
from collections import Counter
from pathlib import Path

TEST = re.compile(r"^\d+/\d+ Test: (.+)$", re.MULTILINE)
# What GoogleTest prints: "FILE:LINE: Skipped" and the reason on the next line.
GTEST = re.compile(r"^\S+:\d+: Skipped\n(.*)$", re.MULTILINE)


def skipped(log):
    """(test, reason) of each that was skipped, in CTest's log of its last run."""
    starts = list(TEST.finditer(log))
    for start, end in zip(starts, starts[1:] + [None]):
        block = log[start.end():end.start() if end else len(log)]
        reason = GTEST.search(block)
        if reason and "[  SKIPPED ]" in block:
            yield start[1], reason[1].strip()
        elif "Test Skipped." in block or "Skipped" in block.split("Test time =")[-1][:200]:
            lines = [line for line in block.split("Output:")[-1].splitlines() if line.strip("- ")]
            yield start[1], (lines[0] if lines else "no reason given")


def expected(text, with_shared_data):
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            reason, when = line.rsplit(" : ", 1)
            if not (with_shared_data and when.startswith("without the shared data")):
                yield re.compile(reason)


def self_test():
    log = ("1/2 Test: A.B\nOutput:\n---\nx.cpp:3: Skipped\nno such thing\n[  SKIPPED ] A.B\n"
           "2/2 Test: C.D\nOutput:\n---\n[       OK ] C.D\nTest Passed.\n")
    if list(skipped(log)) != [("A.B", "no such thing")]:
        return "self-test: does not see a skipped test"
    known = "a reason : without the shared data; x\n"
    if list(expected(known, True)) or not list(expected(known, False)):
        return "self-test: does not tell when a reason counts"
    return None


def main(list_file, log_file, shared):
    if fault := self_test():
        print(fault, file=sys.stderr)
        return 1
    allowed = list(expected(Path(list_file).read_text(encoding="utf-8"), Path(shared).is_dir()))
    found = list(skipped(Path(log_file).read_text(encoding="utf-8", errors="replace")))
    reasons = Counter(reason for _, reason in found)
    for reason, count in reasons.most_common():
        print(f"skipped {count}: {reason}")
    wrong = [(test, reason) for test, reason in found if not any(p.search(reason) for p in allowed)]
    for test, reason in wrong:
        print(f"unexpected skip: {test}: {reason}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
