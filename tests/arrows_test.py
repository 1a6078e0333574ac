#!/usr/bin/env python3
"""Fails when an include breaks the table of rooms: arrows point only down, and only at front doors.

usage: arrows_test.py ROOT

A room may include its own headers, the public header room/room.h of the rooms below it, and any
header of core. The check first runs on made-up files: one that sees nothing cannot pass.
"""
import posixpath
import re
import sys
from pathlib import Path

MAY_INCLUDE = {
    "core": set(),
    "codec": {"core"},
    "calib": {"codec", "core"},
    "capture": {"calib", "codec", "core"},
    "lighting": {"core"},
    "prt": {"lighting", "codec", "core"},
    "shadows": {"prt", "lighting", "core"},
    "compositor": {"shadows", "prt", "lighting", "codec", "core"},
}
MAY_INCLUDE["service"] = set(MAY_INCLUDE)

INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*["<]([^">]+)[">]', re.MULTILINE)
BLOCK_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def fault(path, target, files):
    """Why the file at `path` may not include `target`; None when it may."""
    room = path.split("/")[0]
    beside = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
    # As the compiler looks it up: beside the file first, then from the root.
    target = beside if beside in files or target.startswith(".") else posixpath.normpath(target)
    other = target.split("/")[0]
    if other not in MAY_INCLUDE or other == room:
        return "tests are not for products" if other == "tests" else None
    if other not in MAY_INCLUDE[room]:
        return f"{room} may not include {other}"
    if other != "core" and target != f"{other}/{other}.h":
        return f"of {other} only {other}/{other}.h is public"
    return None


def broken_arrows(files):
    """Lines `file:line: reason` for every forbidden include in {path from the root: text}."""
    found = []
    for path, text in sorted(files.items()):
        text = BLOCK_COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)
        for include in INCLUDE.finditer(text):
            if why := fault(path, include[1], files):
                line = text.count("\n", 0, include.start(1)) + 1
                found.append(f'{path}:{line}: includes "{include[1]}": {why}')
    return found


def self_test():
    """What the check gets wrong about made-up files."""
    ray_pattern = {"prt/ray_pattern.h": "", "core/units.h": ""}
    allowed = [
        ("prt/a.cpp", '#include "prt/ray_pattern.h"'),
        ("prt/a.cpp", '#include "ray_pattern.h"'),
        ("prt/a.cpp", '#include "core/units.h"'),
        ("prt/a.cpp", '#include "codec/codec.h"'),
        ("prt/a.cpp", "#include <embree3/rtcore.h>"),
        ("prt/a.cpp", '// #include "service/service.h"'),
        ("prt/a.cpp", '/*\n#include "service/service.h"\n*/'),
        ("service/a.cpp", '#include "compositor/compositor.h"'),
    ]
    forbidden = [
        ("core/a.h", '#include "codec/codec.h"', 1),
        ("lighting/a.cpp", '#include "capture/capture.h"', 1),
        ("shadows/a.cpp", '\n#include "codec/codec.h"', 2),
        ("capture/a.h", '#pragma once\n\n#  include "lighting/lighting.h"', 3),
        ("compositor/a.cpp", '#include "prt/ray_pattern.h"', 1),
        ("shadows/a.cpp", '#include "../prt/ray_pattern.h"', 1),
        ("service/a.cpp", "#include <prt/ray_pattern.h>", 1),
        ("calib/a.cpp", '/* x */ #include "prt/prt.h"', 1),
        ("prt/a.cpp", '#include "tests/support/temp_folder.h"', 1),
    ]
    wrong = [f"refused {path}: {text!r}" for path, text in allowed
             if broken_arrows({path: text} | ray_pattern)]
    for path, text, line in forbidden:
        found = broken_arrows({path: text} | ray_pattern)
        if len(found) != 1 or not found[0].startswith(f"{path}:{line}: "):
            wrong.append(f"did not find {path}:{line}: {text!r}")
    return wrong


def main(arguments):
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(arguments[0])
    faults = [f"self-test: {line}" for line in self_test()]
    files = {}
    for room in MAY_INCLUDE:
        sources = [p for p in (root / room).rglob("*") if p.suffix in (".cpp", ".h")]
        if not sources:
            faults.append(f"{room}: no source found in {root}")
        files |= {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8") for p in sources}
    faults += broken_arrows(files)
    for line in faults:
        print(line, file=sys.stderr)
    if not faults:
        print(f"{len(files)} files keep to the arrows")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
