#!/usr/bin/env python3
"""Fails when an include breaks the table of rooms: arrows point only down, and only at front doors.

usage: arrows_test.py ROOT

A room or inner room may include its own headers and the public headers of the rooms that its row
names. Headers in internal/ are their room's own; no public header includes one, and no header
includes itself by way of others. The check first runs on made-up files: one that sees nothing
cannot pass.
"""
import posixpath
import re
import sys
from pathlib import Path

# From the bottom to the top; a name stands for what it may include in turn as well.
ROOMS = {
    "core": "",
    "codec": "core",
    "calib/camera": "core",
    "calib/estimate": "calib/camera codec core",
    "capture": "calib/camera codec core",
    "capture/hdr": "capture calib/camera core",
    "capture/environment": "capture/hdr capture calib/camera codec core",
    "capture/studio": "capture/hdr capture calib/camera core",
    "capture/recording": "capture calib/camera codec core",
    "capture/device": "capture/recording capture/hdr capture calib/camera core",
    "lighting/sh": "core",
    "lighting/lights": "lighting/sh core",
    "lighting": "lighting/lights lighting/sh core",
    "prt/geometry": "codec core",
    "prt/transfer": "prt/geometry core",
    "prt/bake": "prt/transfer prt/geometry lighting/sh core",
    "prt/clip": "prt/bake prt/transfer prt/geometry lighting/sh codec core",
    "prt/reference": "prt/geometry lighting/sh core",
    "shadows/silhouette": "prt/transfer prt/geometry lighting/lights lighting/sh core",
    "shadows/field": "prt/bake prt/transfer prt/geometry lighting/lights lighting/sh core",
    "shadows/visibility": "shadows/silhouette prt/transfer prt/geometry lighting/lights"
                          " lighting/sh core",
    "compositor": "shadows/field shadows/silhouette prt/clip prt/bake prt/transfer prt/geometry"
                  " calib/camera codec core",
    "runtime/scene": "shadows/visibility shadows/silhouette prt/clip prt/bake"
                     " prt/transfer prt/geometry capture/recording capture calib/camera codec"
                     " core",
    "runtime/surroundings": "runtime/scene compositor shadows/field shadows/silhouette"
                            " prt/bake prt/geometry core",
    "runtime/shading": "runtime/surroundings runtime/scene compositor shadows/visibility"
                       " shadows/field shadows/silhouette prt/clip prt/bake prt/transfer"
                       " prt/geometry capture/hdr capture calib/camera lighting lighting/lights"
                       " lighting/sh core",
    "runtime/pipeline": "runtime/shading runtime/surroundings runtime/scene compositor"
                        " shadows/field prt/bake prt/transfer prt/geometry capture/environment"
                        " capture/hdr capture calib/camera lighting lighting/lights lighting/sh"
                        " core",
    "runtime/studio": "runtime/pipeline runtime/scene prt/reference prt/geometry capture/studio"
                      " calib/camera capture/environment capture core",
    "service": "runtime/studio runtime/pipeline runtime/shading runtime/scene compositor"
               " capture/device capture/recording capture/studio capture lighting"
               " lighting/lights lighting/sh codec core",
}
LIBRARY = [room for room in ROOMS if room != "service"]
ROOMS["tools/common"] = " ".join(LIBRARY)
ROOMS["tools/pictures"] = ROOMS["tools/demo"] = "tools/common " + ROOMS["tools/common"]
ROOMS["tools/penumbrad"] = "tools/common service"
ROOMS["tools/penumbra"] = "tools/pictures tools/common service " + ROOMS["tools/common"]
ROOMS["tools/calibrate"] = ROOMS["tools/penumbra"]
ROOMS["tools/chart"] = ROOMS["tools/penumbra"]
ROOMS = {room: set(below.split()) for room, below in ROOMS.items()}
# All public headers of a room, for programs and tests; the library itself includes what it needs.
UMBRELLAS = {f"{room}/{room}.h" for room in ("calib", "capture", "lighting", "prt", "shadows")}

INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*["<]([^">]+)[">]', re.MULTILINE)
BLOCK_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def room_of(path):
    """The innermost room that a path lies in; None outside of all."""
    parts = path.split("/")
    for length in (2, 1):
        if len(parts) > length and "/".join(parts[:length]) in ROOMS:
            return "/".join(parts[:length])
    return None


def resolve(path, target, files):
    """As the compiler looks a header up: beside the file first, then from the root."""
    beside = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
    return beside if beside in files or target.startswith(".") else posixpath.normpath(target)


def fault(path, target, files):
    """Why the file at `path` may not include `target`; None when it may."""
    target = resolve(path, target, files)
    if target.startswith("tests/"):
        return "tests are not for products"
    if target in UMBRELLAS:
        return None if path in UMBRELLAS else "umbrella headers are for programs and tests"
    room, other = room_of(path), room_of(target)
    if other is None or path in UMBRELLAS:
        return None
    internal = "/internal/" in target
    if other == room:
        public = path.endswith(".h") and "/internal/" not in path
        return "a public header shows a private one" if internal and public else None
    if other not in ROOMS[room]:
        return f"{room} may not include {other}"
    return f"{target} is private to {other}" if internal else None


def includes_of(text):
    text = BLOCK_COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)
    for include in INCLUDE.finditer(text):
        yield include[1], text.count("\n", 0, include.start(1)) + 1


def circles(files):
    """Lines for each header that includes itself by way of others."""
    arrows = {path: [resolve(path, target, files) for target, _ in includes_of(text)]
              for path, text in files.items() if path.endswith(".h")}
    found, done = [], set()

    def follow(path, way):
        if path in way:
            found.append(f"{path}: includes itself: {' -> '.join(way[way.index(path):] + [path])}")
        elif path in arrows and path not in done:
            for target in arrows[path]:
                follow(target, way + [path])
            done.add(path)

    for path in sorted(arrows):
        follow(path, [])
    return found


def broken_arrows(files):
    """Lines `file:line: reason` for every forbidden include in {path from the root: text}."""
    found = []
    for path, text in sorted(files.items()):
        for target, line in includes_of(text):
            if why := fault(path, target, files):
                found.append(f'{path}:{line}: includes "{target}": {why}')
    return found + circles(files)


def self_test():
    """What the check gets wrong about made-up files."""
    others = {"prt/geometry/rays.h": "", "prt/geometry/internal/embree.h": "", "core/units.h": ""}
    allowed = [
        ("prt/geometry/a.cpp", '#include "prt/geometry/internal/embree.h"'),
        ("prt/geometry/a.cpp", '#include "rays.h"'),
        ("prt/bake/a.cpp", '#include "prt/geometry/rays.h"'),
        ("prt/geometry/a.cpp", '#include "core/units.h"'),
        ("prt/geometry/a.cpp", "#include <embree3/rtcore.h>"),
        ("prt/geometry/a.cpp", '// #include "service/service.h"'),
        ("prt/geometry/a.cpp", '/*\n#include "service/service.h"\n*/'),
        ("tools/chart/a.cpp", '#include "compositor/compositor.h"'),
        ("prt/prt.h", '#include "prt/geometry/rays.h"'),
    ]
    forbidden = [
        ("core/a.h", '#include "codec/codec.h"', 1),
        ("lighting/a.cpp", '#include "capture/frames.h"', 1),
        ("shadows/field/a.cpp", '\n#include "codec/codec.h"', 2),
        ("capture/hdr/a.h", '#pragma once\n\n#  include "lighting/estimate.h"', 3),
        ("prt/geometry/a.cpp", '#include "prt/bake/bake.h"', 1),
        ("prt/bake/a.cpp", '#include "prt/geometry/internal/embree.h"', 1),
        ("prt/bake/a.cpp", '#include "../geometry/internal/embree.h"', 1),
        ("prt/geometry/a.h", '#include "prt/geometry/internal/embree.h"', 1),
        ("calib/camera/a.cpp", '#include "calib/estimate/boards.h"', 1),
        ("runtime/scene/a.cpp", '#include "runtime/pipeline/pipeline.h"', 1),
        ("service/a.cpp", "#include <tools/chart/flip.h>", 1),
        ("tools/penumbra/a.cpp", '#include "tools/chart/flip.h"', 1),
        ("compositor/a.cpp", '/* x */ #include "prt/prt.h"', 1),
        ("prt/bake/a.cpp", '#include "tests/support/temp_folder.h"', 1),
    ]
    wrong = [f"refused {path}: {text!r}" for path, text in allowed
             if broken_arrows({path: text} | others)]
    for path, text, line in forbidden:
        found = broken_arrows({path: text} | others)
        if len(found) != 1 or not found[0].startswith(f"{path}:{line}: "):
            wrong.append(f"did not find {path}:{line}: {text!r}")
    if len(circles({"core/a.h": '#include "core/b.h"', "core/b.h": '#include "core/a.h"'})) != 1:
        wrong.append("did not find the circle of two headers")
    return wrong


def main(arguments):
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(arguments[0])
    faults = [f"self-test: {line}" for line in self_test()]
    files = {}
    for top in sorted({room.split("/")[0] for room in ROOMS}):
        sources = [p for p in (root / top).rglob("*") if p.suffix in (".cpp", ".h")]
        files |= {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8") for p in sources}
    for room in ROOMS:
        if not any(room_of(path) == room for path in files):
            faults.append(f"{room}: no source found in {root}")
    faults += [f"{path}: lies in no room" for path in files
               if room_of(path) is None and path not in UMBRELLAS]
    faults += broken_arrows(files)
    for line in faults:
        print(line, file=sys.stderr)
    if not faults:
        print(f"{len(files)} files keep to the arrows")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
