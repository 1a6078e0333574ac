#!/usr/bin/env python3
"""Fails when an include breaks the arrows between rooms: they point only down, at front doors.

usage: arrows_test.py ROOT

A room may include its own headers and the public headers of the rooms that its targets link, as the
compiler sees them: what it links PUBLIC or PRIVATE, and what those link PUBLIC in turn. A link
points down the list below. Headers in internal/ are their room's own; no public header includes
one, and no header includes itself by way of others. The check first runs on made-up files: one that
sees nothing cannot pass.
"""
import posixpath
import re
import sys
from pathlib import Path

# From the bottom to the top.
ROOMS = """core core/threads core/io codec codec/tone calib/camera calib/import calib/estimate calib/track
capture capture/poses capture/hdr capture/watch capture/ring capture/environment capture/studio
capture/recording capture/device lighting/sh lighting/lights lighting/reflections lighting
prt/geometry prt/rays prt/transfer prt/bake prt/clip prt/reference
shadows/silhouette shadows/field shadows/visibility
compositor compositor/layers compositor/pixels compositor/composite
runtime/scene runtime/surroundings runtime/direct runtime/foreground runtime/shading
runtime/governor runtime/pipeline runtime/studio
service/client service/openxr service/scene service/recording service/outputs service/headset
service/poses service/http service
tools/common tools/plots tools/farm tools/runs tools/pictures tools/demo tools/penumbrad tools/penumbra tools/calibrate
tools/chart/measures tools/chart/governor tools/chart/benches tools/chart/peers tools/chart/charts tools/chart""".split()
# All public headers of a room, for programs and tests; the library itself includes what it needs.
UMBRELLAS = {f"{room}/{room}.h" for room in ("calib", "capture", "lighting", "prt", "shadows")}

INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*["<]([^">]+)[">]', re.MULTILINE)
BLOCK_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def room_of(path):
    """The innermost room that a path lies in; None outside of all."""
    parts = path.split("/")
    for length in (3, 2, 1):
        if len(parts) > length and "/".join(parts[:length]) in ROOMS:
            return "/".join(parts[:length])
    return None


def targets_of(cmake):
    """{target: (room or None, {linked: whether PUBLIC})} of {path: text} of CMakeLists.txt."""
    found = {}
    for path, text in cmake.items():
        text = re.sub(r"#[^\n]*", "", text)
        for kind, words in re.findall(r"penumbra_(module|program|umbrella)\(([^)]*)\)", text):
            name, *words = words.split()
            links, public = {}, kind == "umbrella"
            for word in words:
                if word in ("PUBLIC", "PRIVATE", "LINK", "SOURCES"):
                    public = word == "PUBLIC"
                elif word.startswith("penumbra::"):
                    links[word.removeprefix("penumbra::")] = public
            found[name] = (room_of(path) if kind != "umbrella" else None, links)
        # What goes into other people's programs is made without our own flags.
        for name in re.findall(r"add_library\(penumbra_(\w+) (?:STATIC|MODULE) \$\{sources", text):
            linked = re.findall(rf"target_link_libraries\(penumbra_{name} PRIVATE ([^)]*)\)", text)
            found[name] = (room_of(path), {link.removeprefix("penumbra::"): False
                                           for link in " ".join(linked).split()
                                           if link.startswith("penumbra::")})
    return found


def rooms_below(cmake):
    """{room: rooms whose headers it may include} by what targets link."""
    targets = targets_of(cmake)

    def visible(name, only_public):
        out = set()
        for link, public in targets[name][1].items():
            if link in targets and (public or not only_public):
                out |= {link} | visible(link, True)
        return out

    below = {room: set() for room in ROOMS}
    for name, (room, _) in targets.items():
        if room is not None:
            below[room] |= {targets[link][0] for link in visible(name, False)} - {room, None}
    return below


def links_upward(below):
    return [f"{room}: links {other}, which stands above it" for room in ROOMS
            for other in sorted(below[room]) if ROOMS.index(other) > ROOMS.index(room)]


def told_links(page):
    """{room: (links, links in brackets)} of the table of rooms in docs/architecture.md."""
    found = {}
    for room, links in re.findall(r"^\| `([\w/]+)` \|[^|]*\|([^|]*)\|", page, re.MULTILINE):
        private = re.search(r"\[(.*)\]", links)
        plain = re.sub(r"\[.*\]", "", links)
        found[room] = (set(re.findall(r"\w+", plain)),
                       set(re.findall(r"\w+", private[1])) if private else set())
    return found


def wrong_table(page, cmake):
    """Lines for each row that says other links than CMake has."""
    told, targets, wrong = told_links(page), targets_of(cmake), []
    for room in ROOMS:
        own = {name: links for name, (its, links) in targets.items() if its == room}
        links = [(link, public or room.startswith("tools/") and name.startswith("penumbra"))
                 for name, both in own.items() for link, public in both.items() if link not in own]
        true = ({link for link, public in links if public},
                {link for link, public in links if not public})
        true = (true[0], true[1] - true[0])
        if told.get(room) != true:
            names = ", ".join(sorted(true[0])) + f" [{', '.join(sorted(true[1]))}]"
            wrong.append(f"docs/architecture.md: {room} links {names}")
    return wrong


def resolve(path, target, files):
    """As the compiler looks a header up: beside the file first, then from the root."""
    beside = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
    return beside if beside in files or target.startswith(".") else posixpath.normpath(target)


def fault(path, target, files, below):
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
    if other not in below[room]:
        return f"{room} does not link {other}"
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


def broken_arrows(files, below):
    """Lines `file:line: reason` for every forbidden include in {path from the root: text}."""
    found = []
    for path, text in sorted(files.items()):
        for target, line in includes_of(text):
            if why := fault(path, target, files, below):
                found.append(f'{path}:{line}: includes "{target}": {why}')
    return found + circles(files)


def self_test():
    """What the check gets wrong about made-up files."""
    below = rooms_below({
        "core/CMakeLists.txt": "penumbra_module(values SOURCES a.cpp)\n"
                               "penumbra_umbrella(core penumbra::values)",
        "codec/CMakeLists.txt": "penumbra_module(codec SOURCES a.cpp PUBLIC penumbra::core)",
        "prt/geometry/CMakeLists.txt": "penumbra_module(geometry SOURCES a.cpp\n  PUBLIC"
                                       " embree penumbra::core # penumbra::bake\n"
                                       "  PRIVATE penumbra::codec)",
        "prt/bake/CMakeLists.txt": "penumbra_module(bake INTERNAL SOURCES a.cpp"
                                   " PUBLIC penumbra::geometry)",
        "compositor/CMakeLists.txt": "penumbra_module(compositor PUBLIC penumbra::bake)",
        "tools/chart/CMakeLists.txt": "penumbra_program(chart LINK penumbra::compositor)"})
    others = {"prt/geometry/rays.h": "", "prt/geometry/internal/embree.h": "", "core/units.h": ""}
    allowed = [
        ("prt/geometry/a.cpp", '#include "prt/geometry/internal/embree.h"'),
        ("prt/geometry/a.cpp", '#include "rays.h"'),
        ("prt/bake/a.cpp", '#include "prt/geometry/rays.h"'),
        ("prt/geometry/a.cpp", '#include "core/units.h"'),
        ("prt/geometry/a.cpp", "#include <embree3/rtcore.h>"),
        ("prt/geometry/a.cpp", '// #include "service/service.h"'),
        ("prt/geometry/a.cpp", '/*\n#include "service/service.h"\n*/'),
        ("prt/geometry/a.cpp", '#include "codec/codec.h"'),
        ("tools/chart/a.cpp", '#include "prt/geometry/rays.h"'),
        ("tools/chart/a.cpp", '#include "compositor/view.h"'),
        ("prt/prt.h", '#include "prt/geometry/rays.h"'),
    ]
    forbidden = [
        ("core/a.h", '#include "codec/codec.h"', 1),
        ("prt/bake/a.cpp", '#include "codec/codec.h"', 1),
        ("lighting/a.cpp", '#include "capture/frames.h"', 1),
        ("shadows/field/a.cpp", '\n#include "codec/codec.h"', 2),
        ("capture/hdr/a.h", '#pragma once\n\n#  include "lighting/estimate.h"', 3),
        ("prt/geometry/a.cpp", '#include "prt/bake/bake.h"', 1),
        ("prt/bake/a.cpp", '#include "prt/geometry/internal/embree.h"', 1),
        ("prt/bake/a.cpp", '#include "../geometry/internal/embree.h"', 1),
        ("prt/geometry/a.h", '#include "prt/geometry/internal/embree.h"', 1),
        ("calib/camera/a.cpp", '#include "calib/estimate/boards.h"', 1),
        ("runtime/scene/a.cpp", '#include "runtime/pipeline/pipeline.h"', 1),
        ("service/a.cpp", "#include <tools/chart/measures/flip.h>", 1),
        ("tools/penumbra/a.cpp", '#include "tools/chart/measures/flip.h"', 1),
        ("compositor/a.cpp", '/* x */ #include "prt/prt.h"', 1),
        ("prt/bake/a.cpp", '#include "tests/support/temp_folder.h"', 1),
    ]
    wrong = [f"refused {path}: {text!r}" for path, text in allowed
             if broken_arrows({path: text} | others, below)]
    for path, text, line in forbidden:
        found = broken_arrows({path: text} | others, below)
        if len(found) != 1 or not found[0].startswith(f"{path}:{line}: "):
            wrong.append(f"did not find {path}:{line}: {text!r}")
    codec = {"codec/CMakeLists.txt": "penumbra_module(codec PUBLIC penumbra::core"
                                     " PRIVATE penumbra::x)"}
    for table, right in (("| `codec` | codec | core, [x] | image files |", True),
                         ("| `codec` | codec | core, x | image files |", False)):
        if any("codec links" in line for line in wrong_table(table, codec)) == right:
            wrong.append(f"did not read {table!r}")
    if links_upward(below) or not links_upward(below | {"core": {"codec"}}):
        wrong.append("did not tell a link upward from one down")
    if len(circles({"core/a.h": '#include "core/b.h"', "core/b.h": '#include "core/a.h"'})) != 1:
        wrong.append("did not find the circle of two headers")
    return wrong


def main(arguments):
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(arguments[0])
    faults = [f"self-test: {line}" for line in self_test()]
    cmake, files = {}, {}
    for top in sorted({room.split("/")[0] for room in ROOMS}):
        sources = [p for p in (root / top).rglob("*") if p.suffix in (".cpp", ".h")]
        cmake |= {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8")
                  for p in (root / top).rglob("CMakeLists.txt")}
        files |= {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8") for p in sources}
    for room in ROOMS:
        if not any(room_of(path) == room for path in files):
            faults.append(f"{room}: no source found in {root}")
    faults += [f"{path}: lies in no room" for path in files
               if room_of(path) is None and path not in UMBRELLAS]
    below = rooms_below(cmake)
    page = (root / "docs" / "architecture.md").read_text(encoding="utf-8")
    faults += wrong_table(page, cmake)
    faults += links_upward(below) + broken_arrows(files, below)
    for line in faults:
        print(line, file=sys.stderr)
    if not faults:
        print(f"{len(files)} files keep to the arrows")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
