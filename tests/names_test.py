#!/usr/bin/env python3
"""Fails when names have two owners, or when the pages tell other names than the code.

usage: names_test.py ROOT

No two product files define a type of the same name. Nested types count, `struct X::Impl` does not.
No two test programs have a suite of the same name. No constant is called
kMost, kLeast, kMaximum or kMinimum: kMax, kMin.
Each table of TOML keys or JSON names in docs/reference/ holds what the code of that very table
reads or writes, and nothing else. docs/accuracy.csv has the columns of the chart. Every check first
runs on made-up faults: one that sees nothing cannot pass.
"""
import re
import sys
from collections import defaultdict
from pathlib import Path

from docs_test import REFERENCE, lines_of, tables_of

ROOMS = "core codec calib capture lighting prt shadows compositor runtime service tools".split()
# Comments, raw strings (shaders) and strings hold no types of ours.
NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|R"\w*\(.*?\)\w*"|"(?:\\.|[^"\\\n])*"', re.DOTALL)
TYPE = re.compile(r"^[ \t]*(?:struct|class|enum class|enum)\s+(?:alignas\(\d+\)\s*)?([A-Z]\w*)\s*"
                  r"(?:final\s*)?(?::[^;{:][^;{]*)?\{", re.MULTILINE)
SUITE = re.compile(r"^(?:TYPED_)?TEST(?:_F|_P)?\((\w+),", re.MULTILINE)
ALIAS = re.compile(r"^[ \t]*using ([A-Z]\w*) =\s*([^;]*);", re.MULTILINE)
OLD_BOUND = re.compile(r"\bk(?:Most|Least|Maximum|Minimum)[A-Z]\w*")
WORD = re.compile(r"`(\w+)`")
# constexpr std::string_view known[] = {"version", "camera"};
KEY_LIST = re.compile(r'string_view(?:,\s*\d+>)?\s+(known|inside|\w*[kK]eys)(?:\[\d*\])?\s*=?\s*'
                      r'\{(?:\s*"\w+"\s*,?)+\s*\}')
READ_KEY = re.compile(r'"(\w+)"')
# "[calibration]\n" and "name = {}\n" in a format string
WRITTEN_KEY = re.compile(r'(?:\\n|")(?:\[\[?(\w+)\]|(\w+) *= *(?:[{\[\d]|\\"))')
# {"fps", ...} and out["fps"]
JSON_NAME = re.compile(r'\{"(\w+)",|\["(\w+)"\]')

# What code knows the names of which table, by page, heading and order below the heading. A place is
# `file: text > text`: the line with the first text and what is indented below it, within that the
# same with the next text. `[rig]` at the end stands for the keys that format strings write below
# [rig], `[]` for those on top. Places and single names are added by + and taken away by -.
SCENE, RIG = "runtime/scene/scene_file.cpp", "service/rig_config.cpp: read_rig_config("
MANIFEST, CAMERA = "capture/recording/folder_manifest.cpp", "capture/recording/camera_table"
CALIBRATION = "calib/camera/calibration_files.cpp"
POSES = "tools/calibrate/command_rig.cpp: print_pose_file("
HTTP, REPORT = "service/http/state_json.cpp", "runtime/pipeline/report.h"
SUMMARY = "tools/runs/summary.cpp: summarise("
CONFIGURATION = SUMMARY + ' > {"configuration"'
RECORD = "tools/penumbra/command_record.cpp: to_json("
TONEMAP = "tools/penumbra/command_tonemap.cpp: print_json("
BAKE = "tools/penumbra/bake/command_bake.cpp: print_json("
MERGE = "tools/penumbra/command_hdr.cpp: print_json("
ENVIRONMENT = "tools/penumbra/command_environment.cpp"
FLAGS = "tools/farm/slurm_flags.cpp"
CLIP, SENSOR = "tools/penumbra/bake/command_bake_clip.cpp", "tools/chart/command_chart_sensor.cpp"
CHART = "tools/chart/charts/chart_plot.cpp: chart_row("
TABLES = {
    "scene.md": {
        "The file": [f"{SCENE}: read_scene( > known[]"],
        "Virtual objects: `[[object]]`": [f"{SCENE}: kObjectKeys[]"],
        "Real surfaces: `[[real]]`": [f"{SCENE}: kRealKeys[]", f"{SCENE}: read_real( > known[]"],
        "Virtual lamps: `[[lamp]]`": [f"{SCENE}: read_lamp( > known[]"],
        "The sun: `[sun]`": [f"{SCENE}: read_sun( > known[]"]},
    "rig.md": {
        "The file": [f"{RIG} > known[]"],
        "The source: `[capture]`": [f"{RIG} > capture_keys[]"],
        "The scene: `[scene]`": [f"{RIG} > scene_keys[]"],
        "The light: `[light]`": [f"{RIG} > light_keys[]"],
        "The HTTP interface: `[http]`": [f"{RIG} > http_keys[]"],
        "What goes out: `[output]`": [f"{RIG} > output_keys[]"],
        "Cameras: `[[camera]]`": ["capture/device/rig_file.cpp: kDeviceKeys[]"]},
    "poses.md": {
        "Live poses": ["service/poses/pose_config.cpp: read_pose_config( > pose_keys[]"],
        "Boards": ["service/poses/pose_config.cpp: read_board( > board_keys[]"]},
    "headset.md": {
        "Headset": [f"{RIG} > headset_keys[]"]},
    "capture-folder.md": {
        "The file": [f"{MANIFEST}: read_manifest( > known[]"],
        "Cameras: `[[camera]]`": [f"{CAMERA}.h: kCameraKeys"],
        "Lenses: `[[camera.lens]]`": [f"{CAMERA}.cpp: kLensKeys[]"],
        "Mirror balls: `[camera.ball]`": [f"{CAMERA}.cpp: kBallKeys[]"]},
    "recording.md": {
        "cameras.toml": ["capture/recording/recording_reader.cpp: ::read_cameras( > known[]"],
        "The table `[light_track]`": [
            "capture/recording/recording_reader.cpp: ::read_light_track( > known[]"]},
    "calibration-files.md": {
        "Cameras": [f"{MANIFEST}: read_camera_file( > known[] - version camera + "
                    "tools/calibrate/command_camera.cpp: print_camera_file( > [calibration]"],
        "Response": ["calib/camera/response.cpp: read_response("],
        "Noise": [f"{CALIBRATION}: parse_noise_file( > known[] - version + "
                  f"{CALIBRATION}: parse_noise_file( > inside[]"],
        "Vignetting": [f"{CALIBRATION}: parse_vignetting_file( > known[] - version + "
                       f"{CALIBRATION}: parse_vignetting_file( > inside[]"],
        "Colour": [f"{CALIBRATION}: parse_colour_file( > known[] - version + "
                   f"{CALIBRATION}: parse_colour_file( > inside[]"],
        "Poses": [f"{POSES} > [] - version + {POSES} > [rig] + {POSES} > [camera]"]},
    "http.md": {
        "`/healthz`": [f"{HTTP}: json health_json(", f"{HTTP}: capture::CameraCounts& c)"],
        "`/v1/light`": [f"{REPORT}: json to_json(const lighting::LightEstimate& + "
                        f"{HTTP}: json light_json(",
                        f"{REPORT}: json to_json(const lighting::DistantLight&",
                        f"{REPORT}: json to_json(const lighting::LightUncertainty&",
                        f"{REPORT}: json to_json(const lighting::Plan&"],
        "`/v1/objects`": ["service/scene/scene_control.cpp: kChangeKeys[]",
                          "service/scene/scene_control.cpp: kNewKeys[]"],
        "Scenes and lamps": ["service/scene/scene_control.cpp: kLampKeys[]"]},
    "json.md": {
        "demo, composite and summary.json": [
            f"{SUMMARY} - {CONFIGURATION} + configuration", f"{CONFIGURATION} - configuration",
            f"{REPORT}: json to_json(const ProcessorTimes&"],
        "render": ["tools/penumbra/command_render.cpp: print_json("],
        "record": [f"{RECORD} > return"],
        "tonemap": [TONEMAP + " + pictures"],
        "encode": ['tools/penumbra/command_encode.cpp: print_json({{"width", pixels'],
        "decode": ['tools/penumbra/command_encode.cpp: print_json({{"width", input'],
        "bake": [BAKE, CLIP + ': print_json({{"clip" - ' + BAKE],
        "hdr merge and hdr environment": [f"{MERGE} + {ENVIRONMENT}: print_json("],
        "light estimate": ["tools/penumbra/command_light.cpp: if (o.json) - lights residual"],
        "chart": [CHART, f"{SENSOR}: sensor_row("],
        "compare": ["tools/chart/command_compare.cpp: print_json("]},
}
# Names that stand somewhere below a heading, in rows on what holds them or in prose.
INSPECT, MESH = "tools/penumbra/command_inspect.cpp", "tools/penumbra/inspect_mesh.cpp"
OVERTAKEN = f"{REPORT}: json to_json(const OvertakenFrames&"
MENTIONED = {
    "http.md": {"`/healthz`": OVERTAKEN},
    "json.md": {
        "demo, composite and summary.json": f"{REPORT}: json to_json(const StageTimes& + {OVERTAKEN}",
        "inspect": " + ".join(f"{INSPECT}: {start}" for start in (
            "json to_json(const capture::CameraInfo&", "inspect_capture(", "inspect_baked(",
            "inspect_picture(", "inspect_camera(", "inspect_response(",
            "inspect_noise(", "inspect_vignetting(", "inspect_colour(", "inspect_poses(",
            "inspect_rig(", "inspect_scene(", "inspect_cameras(", '".shlm") {',
            "inspect(const")) + f" + {MESH}: json to_json( + {MESH}: json textures_of( + "
                            f"{MESH}: inspect_mesh( - calibration colour",
        "calibrate": " + ".join(f"tools/calibrate/command_{place}" for place in (
            "camera.cpp: json to_json(", 'response.cpp: print_json({{"pictures"',
            "vignetting.cpp: print_json(", "ball.cpp: {{\"centre_m\"", "noise.cpp: json to_json(",
            "rig.cpp: json to_json(", "colour.cpp: print_json(",
            "import.cpp: json to_json(")),
        "record": f"{RECORD} > push_back(",
        "bake": f'{FLAGS}: print_json({{{{"shard", + {FLAGS}: print_json({{{{"shards",',
        "hdr merge and hdr environment": f"{ENVIRONMENT}: views.push_back(",
        "chart": f"{SENSOR}: json to_json(const SensorSummary& + {SENSOR}: print_json( + "
                 'tools/chart/command_chart.cpp: print_json({{"needed_factor" + '
                 "tools/chart/command_chart_clip.cpp: rows.push_back( + "
                 "tools/chart/command_chart_clip.cpp: print_json( + "
                 "tools/chart/command_chart_direct_light.cpp: json to_json( + "
                 "tools/chart/command_chart_direct_light.cpp: print_json( + "
                 "tools/chart/command_chart_light_track.cpp: rows.push_back( + "
                 "tools/chart/command_chart_light_track.cpp: print_json( + "
                 "tools/chart/command_chart_materials.cpp: json to_json( + "
                 "tools/chart/command_chart_materials.cpp: print_json( + "
                 "tools/chart/command_chart_stills.cpp: json to_json( + "
                 "tools/chart/command_chart_stills.cpp: print_json("},
}
JSON_PAGES = ("http.md", "json.md")
PARTS = {"kPlacementKeys"}  # lists of keys that stand in another list, too


# ---- Types. ----

def doubles(files):
    """Types that two files define, and other names for types that are a type's own elsewhere."""
    owners = defaultdict(set)
    for path, text in files.items():
        for name in TYPE.findall(NOISE.sub("", text)):
            owners[name].add(path)
    for path, text in files.items():
        for name, meant in ALIAS.findall(NOISE.sub("", text)):
            if name in owners and not re.search(rf"\b{name}\b", meant):
                owners[name].add(path)
    return [f"{name}: defined in {', '.join(sorted(paths))}"
            for name, paths in sorted(owners.items()) if len(paths) > 1]


def shared_suites(tests):
    """Suites of GoogleTest that two programs (folders of tests) have: CTest knows them by that name."""
    owners = defaultdict(set)
    for path, text in tests.items():
        for suite in SUITE.findall(text):
            owners[suite].add(path.rsplit("/", 1)[0])
    return [f"suite {name}: in {', '.join(sorted(folders))}"
            for name, folders in sorted(owners.items()) if len(folders) > 1]


def old_bounds(files):
    """Constants that say kMost or kLeast for kMax or kMin."""
    return [f"{path}: {name}: kMax or kMin"
            for path, text in files.items() for name in sorted(set(OLD_BOUND.findall(NOISE.sub("", text))))]


# ---- Names in C++. ----

class Moved(Exception):
    """Code that is not where this file says."""


def block(lines, start):
    """Of (number, line): the first line that has `start`, and what is indented below it."""
    out, indent = [], 0
    for number, line in lines:
        depth = len(line) - len(line.lstrip())
        if not out and start not in line:
            continue
        if out and line.strip() and depth <= indent:
            break
        if not out:
            indent = depth
        out.append((number, line))
    return out


def written_keys(lines, table):
    """(name, line) of what format strings write below [table]; on top the tables' names, too."""
    above = ""
    for number, line in lines:
        for section, key in WRITTEN_KEY.findall(line):
            if section and not table:
                yield section, number
            elif key and above == table:
                yield key, number
            above = section or above


def names_at(sources, place, pattern):
    """{name: file:line} at a place of TABLES, and the first line of the code there."""
    path, _, starts = place.partition(": ")
    lines = list(enumerate(sources.get(path, "").splitlines(), 1))
    *starts, last = starts.split(" > ")
    for start in starts if last.startswith("[") else [*starts, last]:
        lines = block(lines, start)
    if not lines:
        raise Moved(f"tests/names_test.py:1: TABLES or MENTIONED: there is no {place}")
    if last.startswith("["):
        found = written_keys(lines, last.strip("[]"))
    else:
        if last.endswith("Keys[]"):  # a list, also where JSON is read
            pattern = READ_KEY
        found = ((name, number) for number, line in lines for match in pattern.finditer(line)
                 for name in match.groups() if name)
    out = {}
    for name, number in found:
        out.setdefault(name, f"{path}:{number}")
    return out, f"{path}:{lines[0][0]}"


def names_of(sources, expression, pattern):
    """{name: file:line} of `place + place - name name`, and the first lines of the code there."""
    out, firsts = {}, set()
    terms = re.split(r" ([+-]) ", expression)
    for sign, term in zip(["+", *terms[1::2]], terms[::2]):
        named = dict.fromkeys(term.split(), "names_test.py")
        if ": " in term:
            named, first = names_at(sources, term, pattern)
            firsts.add(first)
        if sign == "+":
            out = named | out
        else:
            out = {name: place for name, place in out.items() if name not in named}
    return out, firsts


# ---- Names in pages. ----

def section_of(text, wanted):
    """The lines between a heading and the next one."""
    heading, out = "", []
    for _, kind, line in lines_of(text):
        if kind == "heading":
            heading = line.lstrip("#").strip()
        elif heading == wanted:
            out.append(line)
    return "\n".join(out)


def wrong_table(page, line, rows, known):
    """known: {name: place in the code}."""
    documented = {name: number for number, cell in rows for name in WORD.findall(cell)}
    return [f"{page}:{line}: {name}, which {place} has, is not in the table"
            for name, place in known.items() if name not in documented] + [
        f"{page}:{number}: {name} is not known to the code of this table"
        for name, number in documented.items() if name not in known]


def wrong_page(page, text, expected):
    """expected: {heading: [{name: place in the code}]}, a list for each table."""
    tables, found = {heading: [] for heading in expected}, []
    for heading, first, line, rows in tables_of(text):
        if re.match("(key$|name$|name in )", first):
            tables.setdefault(heading, []).append((line, rows))
    for heading, own in tables.items():
        known = expected.get(heading, [])
        if len(own) != len(known):
            line = own[0][0] if own else 1
            found.append(f"{page}:{line}: {heading}: {len(own)} tables of keys or names, "
                         f"{len(known)} in TABLES of names_test.py")
            continue
        for (line, rows), names in zip(own, known):
            found += wrong_table(page, line, rows, names)
    return found


def wrong_names(sources, pages, tables):
    """Both {path: text}; each table against the code that knows its names."""
    found, used = [], set()
    for page in sorted(pages.keys() | tables.keys()):
        pattern, expected = JSON_NAME if page in JSON_PAGES else READ_KEY, {}
        for heading, expressions in tables.get(page, {}).items():
            named = [names_of(sources, expression, pattern) for expression in expressions]
            expected[heading] = [names for names, _ in named]
            used = used.union(*(firsts for _, firsts in named))
        found += wrong_page(REFERENCE + page, pages.get(page, ""), expected)
    for path, text in sorted(sources.items()):
        for keys in KEY_LIST.finditer(text):
            place = f"{path}:{text.count(chr(10), 0, keys.start()) + 1}"
            if place not in used and keys[1] not in PARTS:
                found.append(f"{place}: {keys[1]}: no table of {REFERENCE} is compared with it")
    return found


def unless_moved(check, *arguments):
    try:
        return check(*arguments)
    except Moved as error:
        return [str(error)]


def unmentioned(sources, pages, mentioned):
    found = []
    for page, sections in mentioned.items():
        for heading, expression in sections.items():
            words = set(WORD.findall(section_of(pages.get(page, ""), heading)))
            found += [f"{REFERENCE}{page}:1: {heading}: {name}, which {place} has, is not mentioned"
                      for name, place in names_of(sources, expression, JSON_NAME)[0].items()
                      if name not in words]
    return found


def wrong_columns(header, sources):
    """header: first line of docs/accuracy.csv."""
    columns = list(names_of(sources, CHART, JSON_NAME)[0])
    if header.split(",") == columns:
        return []
    return [f"docs/accuracy.csv:1: the chart has other columns: {','.join(columns)}"]


# ---- The checks on made-up code and pages. ----

MADE_UP_CODE = r"""constexpr std::string_view kThingKeys[] = {"name",
                                            "turn"};
void read(Keys keys) {
  constexpr std::string_view known[] = {"thing", "lamp"};
  use(known, "other");
}
void read_lamp() {
  const std::array<std::string_view, 2> known = {"name", "glow"};
}
std::string print() {
  return fmt::format("top = 1\n[sure]\nrms = {}\n", 1) + "turn  = [{}]\n";
}
Json chart_row(const Point& p) {
  Json out = {{"time", p.time}, {"size",
                                 {{"width", 1}}}};
  out["late"] = "name";
}
"""
MADE_UP_PAGES = {"r.md": """## The file
| key | type |
|---|---|
| `thing` | as `name` |
| `lamp` | table |
## Things
| key | type |
|---|---|
| `name` | text |
| `turn` | number |

More `words`:

| key | type |
|---|---|
| `name`, `glow` | text |
| `rms`, `sure`, `top` | number |
""", "json.md": """## Output
| name | type |
|---|---|
| `time`, `late` | number |
| `size` | `width` |
"""}
MADE_UP_TABLES = {"r.md": {
    "The file": ["a.cpp: read( > known[]"],
    "Things": ["a.cpp: kThingKeys", "a.cpp: read_lamp( > known + a.cpp: print( > [] + "
               "a.cpp: print( > [sure] - turn"]},
    "json.md": {"Output": ["a.cpp: chart_row( - width"]}}


def names_with(old="", new="", code=MADE_UP_CODE):
    """What the check finds with `old` of a page replaced by `new`."""
    assert any(old in text for text in MADE_UP_PAGES.values())
    pages = {page: text.replace(old, new, 1) for page, text in MADE_UP_PAGES.items()}
    return unless_moved(wrong_names, {"a.cpp": code}, pages, MADE_UP_TABLES)


def mentioned_with(old="", new=""):
    pages = {"json.md": MADE_UP_PAGES["json.md"].replace(old, new)}
    return unmentioned({"a.cpp": MADE_UP_CODE}, pages, {"json.md": {"Output": "a.cpp: chart_row("}})


def columns_of(header):
    row = 'Json chart_row(Point p) {\n  return {{"a", p.a}, {"lights", 1}, {"memory_bytes", 2}};\n}\n'
    return wrong_columns(header, {"tools/chart/charts/chart_plot.cpp": row})


def right_names():
    return [names_with(), names_with("More `words`", "More `name`"), mentioned_with(),
            names_with(code=MADE_UP_CODE + 'constexpr std::string_view kNames[] = {"three"};'),
            columns_of("a,lights,memory_bytes")]


def wrong_made_up_names():
    """One fault each; a name that misses or is too much always stands in another table as well."""
    return [
        names_with("| `name` | text |\n"), names_with("`name`, `glow`", "`glow`"),
        names_with("| `turn` |", "| `turn`, `glow` |"),
        names_with("| `lamp` |", "| `lamp`, `name` |"), names_with("`rms`, "),
        names_with("`rms`, ", "`rms`, `turn`, "), names_with(", `late`"),
        names_with("`late`", "`late`, `name`"), names_with("| `size` | `width` |\n"),
        names_with("| `lamp` | table |\n", "| `lamp` | table |\n\n| key |\n|---|\n| `lamp` |\n"),
        names_with("## The file\n", "## Other\n| key |\n\n## The file\n"),
        names_with(code=MADE_UP_CODE + 'constexpr std::string_view kNewKeys[] = {"name"};'),
        names_with(code=MADE_UP_CODE.replace("chart_row(", "rows(")),
        mentioned_with("`width`", "width"),
        columns_of("a,memory_bytes,lights"), columns_of("a,lights"), columns_of("a,discs"),
    ]


def self_test():
    same = {"core/a.h": "struct Part {\n};\n", "prt/b.cpp": "  enum class Part : char { kOne };\n"}
    apart = {"core/a.h": "struct A {};\nstruct Part;\n// struct B {\n", "prt/b.cpp":
             "struct A::Impl {};\nclass B : public A {\n};\nauto s = R\"(struct A { };)\";\n"
             "using A = a::A;\n"}
    alias = {"core/a.h": "struct A {\n};\n", "prt/b.cpp": "using A = std::array<float, 3>;\n"}
    suites = {"tests/a/x.cpp": "TEST(Part, One) {", "tests/a/y.cpp": "TEST_F(Part, Two) {",
              "tests/b/x.cpp": "TEST_P(Other, One) {"}
    bound = {"core/a.h": "// kMostOld\nconstexpr int kMaxNew = 1, kAlmostAll = 2;\n"}
    right = [doubles(apart), shared_suites(suites), old_bounds(bound), *right_names()]
    bound["core/a.h"] += "constexpr int kMostOld = 3;\n"
    suites |= {"tests/b/y.cpp": "TEST_F(Part, One) {"}
    wrong = [doubles(same), doubles(alias), shared_suites(suites), old_bounds(bound), *wrong_made_up_names()]
    out = [f"right case {i}: {lines}" for i, lines in enumerate(right) if lines]
    out += [f"wrong case {i}: {lines}" for i, lines in enumerate(wrong) if len(lines) != 1]
    return [f"self-test: {line}" for line in out]


def main(arguments):
    if len(arguments) != 1:
        sys.exit(__doc__)
    root = Path(arguments[0])

    def texts(folder, *kinds):
        return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
                for path in sorted((root / folder).rglob("*")) if path.suffix in kinds}
    sources = {path: text for room in ROOMS for path, text in texts(room, ".cpp", ".h").items()}
    pages = {path.removeprefix(REFERENCE): text for path, text in texts(REFERENCE, ".md").items()}
    faults = self_test() + doubles(sources) + old_bounds(sources) + shared_suites(texts("tests", ".cpp"))
    faults += unless_moved(wrong_names, sources, pages, TABLES)
    faults += unless_moved(unmentioned, sources, pages, MENTIONED)
    with (root / "docs" / "accuracy.csv").open(encoding="utf-8") as table:
        faults += unless_moved(wrong_columns, table.readline().strip(), sources)
    types = sum(len(TYPE.findall(NOISE.sub("", text))) for text in sources.values())
    if types < 300:
        faults.append(f"only {types} types found: the check is blind")
    for line in faults:
        print(line, file=sys.stderr)
    tables = sum(len(own) for headings in TABLES.values() for own in headings.values())
    print(f"{types} types, {tables} tables of names, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
