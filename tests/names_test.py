#!/usr/bin/env python3
"""Fails when two product files define a type of the same name: one name, one owner.

usage: names_test.py ROOT

Nested types count, `struct X::Impl` does not. The check first runs on made-up files.
"""
import re
import sys
from collections import defaultdict
from pathlib import Path

ROOMS = "core codec calib capture lighting prt shadows compositor runtime service tools".split()
# Comments, raw strings (shaders) and strings hold no types of ours.
NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|R"\w*\(.*?\)\w*"|"(?:\\.|[^"\\\n])*"', re.DOTALL)
TYPE = re.compile(r"^[ \t]*(?:struct|class|enum class|enum)\s+(?:alignas\(\d+\)\s*)?([A-Z]\w*)\s*"
                  r"(?:final\s*)?(?::[^;{:][^;{]*)?\{", re.MULTILINE)


def doubles(files):
    owners = defaultdict(set)
    for path, text in files.items():
        for name in TYPE.findall(NOISE.sub("", text)):
            owners[name].add(path)
    return [f"{name}: defined in {', '.join(sorted(paths))}"
            for name, paths in sorted(owners.items()) if len(paths) > 1]


def self_test():
    same = {"core/a.h": "struct Part {\n};\n", "prt/b.cpp": "  enum class Part : char { kOne };\n"}
    apart = {"core/a.h": "struct A {};\nstruct Part;\n// struct B {\n", "prt/b.cpp":
             "struct A::Impl {};\nclass B : public A {\n};\nauto s = R\"(struct A { };)\";\n"}
    return (["did not find Part"] if len(doubles(same)) != 1 else []) + [
        f"found {line}" for line in doubles(apart)]


def main(arguments):
    if len(arguments) != 1:
        sys.exit(__doc__)
    root = Path(arguments[0])
    files = {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
             for room in ROOMS for path in (root / room).rglob("*") if path.suffix in (".cpp", ".h")}
    faults = [f"self-test: {line}" for line in self_test()] + doubles(files)
    types = sum(len(TYPE.findall(NOISE.sub("", text))) for text in files.values())
    if types < 300:
        faults.append(f"only {types} types found: the check is blind")
    for line in faults:
        print(line, file=sys.stderr)
    print(f"{types} types, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
