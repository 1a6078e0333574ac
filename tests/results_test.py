#!/usr/bin/env python3
"""Fails when docs/results.py misreads an output, or pages and definitions of results differ.

usage: results_test.py ROOT

Runs a copy of the script on made-up programs, one output of each kind; checks that each section of
docs/results.md is defined and tells machine, date and commit, and that each definition names tests
and benchmarks that exist; and that each figure with a unit in README.md also stands in
docs/results.md.
"""
import fnmatch
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from datetime import date
from pathlib import Path

FIGURE = re.compile(r"\d[\d,]*(?:\.\d+)? ?(?:%|ms|px|MB|times|frames a second|fps)(?!\w)")
# *machine; 2001-02-03 to 2001-02-04; commit abcdef0 with changes.*; without git there is no commit
ORIGIN = re.compile(r"\*(?:(?!commit )[^;*\s][^;*]*; )+(\d{4}-\d\d-\d\d)(?: to (\d{4}-\d\d-\d\d))?"
                    r"(?:; commit [0-9a-f]{7,40}(?: with changes)?)*\.\*")
TEST = re.compile(r"^TEST(?:_F|_P)?\((\w+),\s*(\w+)\)", re.MULTILINE)

DEFINITIONS = r"""
[commands]
renderer = "penumbra look"
print = "toy Toy.Prints*"
skip = "toy Toy.Skips"
fail = "toy Toy.Fails"
bench = "bench toy"
table = "penumbra table --out {out}"
maps = "penumbra table --environment {maps} --out {out}"
live = "penumbra live --json --out {out}"
[text]
columns = "what | figure | printed by"
find = '^NAME: (?P<off>[-\d.]+) % of (?P<kind>\d+)'
of = "print"
name = "walk"
matches = 2
rows = [
  { label = "{kind:.0f} times", show = "{off.worst:.1f} %, {off.largest:.1f}" },
  { label = "mean", show = "{off.mean:.2f}" },
  { label = "range", show = "{off.min:.0f} to {off.max:.0f}" },
]
[bench]
columns = "what | figure | printed by"
rows = [
  { label = "a test", of = "print", find = ' of (?P<kind>[79])$', matches = 2, show = "{kind}" },
  { label = "a bench", of = "bench", where = { name = ".*:3" }, show = "{ms[0]:.2g}, {ms[1]:.2g}" },
]
[bench.plot]
file = "toy.svg"
of = "bench"
y = "ms"
label = "ms"
panels = [{ x = "bands", label = "bands", tics = 2, cases = [".*:1/bands:3", ".*:5"] }]
[table]
columns = "what | figure"
of = "table"
table = "rows.csv"
by = ["map"]
copy = { "table/rows.csv" = "rows.csv" }
rows = [
  { label = "chosen", where = { chosen = 1 }, show = "{error.percent.mean:.0f} %" },
  { label = "set", set = "fast", where = { map = "b" }, show = "{ms:.0f}" },
  { label = "between", where = { method = "slow" }, at = { ms = 40 }, show = "{error:.2f}" },
]
[[table.sentences]]
where = { method = "slow" }
over = { chosen = 1 }
show = "Slow takes {ms.min:.0f} to {ms.max:.0f} times as long."
[table.sets.fast]
method = "fast.*"
[json]
columns = "stage | live"
of = ["live"]
show = "{live[stages][NAME][p50_ms]:.1f}"
rows = [{ label = "encode video", name = "encode video" }]
[missing]
columns = "what | figure"
rows = [
  { label = "there", of = "print", find = 'walk: (?P<off>[\d.]+)', show = "{off.max}" },
  { label = "not there", of = "print", find = 'run: (?P<off>[\d.]+)', show = "{off}" },
]
[unplotted]
columns = "what | figure"
rows = [{ label = "a bench", of = "bench", where = { name = ".*:5" }, show = "{ms:.0f}" }]
plot = { file = "none.svg", of = "bench", y = "ms", label = "", panels = [{ x = "ms", label = "", cases = [".*:7"] }] }
[several]
columns = "what | figure"
of = "print"
rows = [{ label = "one of two", find = '^walk: (?P<off>[-\d.]+)', show = "{off:.1f}" }]
[choice]
columns = "what | figure"
of = "print"
rows = [{ label = "two", find = '^walk: (?P<off>[-\d.]+)', matches = 2, show = "{off:.1f}" }]
[failing]
columns = "what | figure"
rows = [{ label = "failing row", of = "fail", find = '(?P<off>[\d.]+)', show = "{off}" }]
[skipped]
columns = "what | figure"
rows = [{ label = "no data", of = "skip", find = 'walk: (?P<off>[\d.]+)', show = "{off}" }]
[absent]
columns = "what | figure"
table = "rows.csv"
rows = [{ label = "no maps", of = "maps", where = { chosen = 1 }, show = "{ms}" }]
[drawn]
gpu = true
columns = "what | figure"
of = "print"
rows = [{ label = "two", find = '^walk: (?P<off>[-\d.]+)', matches = 2, show = "{off.max:.1f}" }]
"""

PROGRAMS = {
    "toy_test": r"""case "$1" in
  *Prints*) echo "$1" >>"$CALLS"; echo "walk: 1.25 % of 7"; echo "walk: -2.5 % of 7" ;;
  *Skips) printf 'toy_test.cpp:7: Skipped\nshared data file absent: toy.hdr\n' ;;
  *Fails) echo "1.5"; echo "toy_test.cpp:9: Failure" >&2; exit 1 ;;
esac
""",
    "penumbra": r"""case "$1" in
  look) echo '{"configuration": {"renderer": "llvmpipe (LLVM 15)"}}' ;;
  table) folder="${!#}"; mkdir -p "$folder"
    printf '%s\n' map,method,chosen,error,ms a,fast,1,.01,1 b,fast,1,.03,2 a,slow,0,.1,10 \
      b,slow,0,.4,160 >"$folder/rows.csv" ;;
  live) echo '{"stages": {"encode video": {"p50_ms": 4.56}}}' ;;
esac
""",
    "penumbra_bench": r"""echo '{"benchmarks": [
  {"name": "toy/threads:1/bands:3", "ms": 2.71, "bands": 3},
  {"name": "toy/threads:2/bands:3", "ms": 1.24, "bands": 3},
  {"name": "toy/threads:1/bands:5", "ms": 9, "bands": 5}]}'
""",
}

EXPECTED = {
    "text": ["| what | figure | printed by |", "|---|---|---|",
             "| 7 times | -2.5 %, 2.5 | `toy Toy.Prints*` |",
             "| mean | -0.62 | `toy Toy.Prints*` |",
             "| range | -2 to 1 | `toy Toy.Prints*` |"],
    "bench": ["| a test | 7.0 | `toy Toy.Prints*` |", "| a bench | 2.7, 1.2 | `bench toy` |"],
    "table": ["Slow takes 10 to 80 times as long.", "", "| what | figure |", "|---|---|",
              "| chosen | 2 % |", "| set | 2 |", "| between | 0.20 |"],
    "json": ["| stage | live |", "|---|---|", "| encode video | 4.6 |"],
}
ERRORS = {
    "missing": "missing: not there: `toy Toy.Prints*`: prints no such figure",
    "several": "several: one of two: `toy Toy.Prints*`: prints 2 such figures instead of 1",
    "choice": "choice: two: `toy Toy.Prints*`: ValueError: 2 figures where one is shown",
    "failing": "failing: failing row: `toy Toy.Fails`: ends with status 1, "
               "see out/results/fail.failed.txt",
    "unplotted": "unplotted: none.svg: .*:7: 0 benchmarks of this name",
    "unknown": "unknown: no such section; there are text, bench, table, json, missing, "
               "unplotted, several, choice, failing, skipped, absent, drawn",
}
ABSENT = {"skipped": "skipped: stays as it is: shared data file absent: toy.hdr",
          "absent": "absent: stays as it is: shared data folder absent: envmaps "
                    "(set PENUMBRA_SHARED_DATA)",
          "drawn": "drawn: stays as it is: needs a GPU"}


class Toy:
    """A tree with a copy of the script, made-up programs and a page of empty sections."""

    def __init__(self, root, folder):
        self.folder = folder
        (folder / "docs").mkdir()
        (folder / "bin").mkdir()
        shutil.copy(root / "docs" / "results.py", folder / "docs")
        (folder / "docs" / "results.toml").write_text(DEFINITIONS, encoding="utf-8")
        for name, text in PROGRAMS.items():
            (folder / "bin" / name).write_text("#!/bin/bash\n" + text, encoding="utf-8")
            (folder / "bin" / name).chmod(0o755)
        self.page = folder / "docs" / "results.md"
        self.page.write_text("# Results\n" + "".join(
            f"\n<!-- results:{name} -->\nold\n<!-- /results -->\n"
            for name in tomllib.loads(DEFINITIONS) if name != "commands"), encoding="utf-8")

    def run(self, *arguments):
        words = [sys.executable, str(self.folder / "docs" / "results.py"), "--build",
                 str(self.folder), *arguments]
        environment = {**os.environ, "PENUMBRA_SHARED_DATA": str(self.folder / "none"),
                       "CALLS": str(self.folder / "calls")}
        return subprocess.run(words, capture_output=True, text=True, env=environment)

    def section(self, name):
        return sections_of(self.page.read_text(encoding="utf-8"))[name].splitlines()


def sections_of(page):
    return dict(re.findall(r"<!-- results:([\w-]+) -->\n(.*?)<!-- /results -->", page, re.DOTALL))


def check_script(root):
    """Lines on what the script does otherwise than it should."""
    with tempfile.TemporaryDirectory() as name:
        toy = Toy(root, Path(name))
        wrong = []
        run = toy.run("--section", *EXPECTED)
        if run.returncode != 0:
            wrong.append(f"right outputs: status {run.returncode}: {run.stderr}")
        for section, lines in EXPECTED.items():
            written = toy.section(section)
            if written[-len(lines):] != lines or ", llvmpipe (no GPU); 20" not in written[0]:
                wrong.append(f"{section}: writes {written}")
        if not (toy.folder / "docs" / "rows.csv").exists():
            wrong.append("a file is not copied")
        plot = toy.folder / "docs" / "toy.svg"
        if not plot.exists() or "in proportion" not in plot.read_text(encoding="utf-8"):
            wrong.append("no plot of a benchmark's growth")
        for section, line in {**ERRORS, **ABSENT}.items():
            before = toy.page.read_text(encoding="utf-8")
            run = toy.run("--section", section)
            said = run.stderr if section in ERRORS else run.stdout
            if line not in said.splitlines() or (run.returncode == 0) == (section in ERRORS):
                wrong.append(f"{section}: status {run.returncode}, says {said!r}")
            if toy.page.read_text(encoding="utf-8") != before:
                wrong.append(f"{section}: the page has changed")
        wrong += check_kept(toy) + check_changes(toy)
    return wrong


def check_kept(toy):
    """--from runs what is not kept alone, and tells the kept output's origin."""
    kept, calls = toy.folder / "kept", toy.folder / "calls"
    kept.mkdir()
    origin = {"machine": "Abacus, 3 cores, no GPU", "date": "2001-02-03", "commit": "abcdef0"}
    (kept / "print.txt").write_text(f"# {json.dumps(origin)}\n" + 2 * "walk: 8.5 % of 9\n",
                                    encoding="utf-8")
    calls.write_text("", encoding="utf-8")
    run = toy.run("--from", str(kept), "--section", "choice", "bench", "drawn")
    choice = "\n".join(toy.section("choice"))
    expected = ("*Abacus, 3 cores, no GPU; 2001-02-03; commit abcdef0.* Printed by "
                "`toy Toy.Prints*`.\n\n| what | figure |\n|---|---|\n| two | 8.5 |")
    wrong = []
    if run.returncode != 0 or calls.read_text(encoding="utf-8"):
        wrong.append(f"--from: status {run.returncode}: {run.stderr}")
    if choice != expected:
        wrong.append(f"--from: writes {choice}")
    if toy.section("drawn")[-1] != "| two | 8.5 |":
        wrong.append(f"--from: leaves out what a GPU drew: {toy.section('drawn')}")
    if "2001-02-03 to 20" not in " ".join(toy.section("bench")):
        wrong.append(f"--from: tells one day for two: {toy.section('bench')}")
    return wrong


def check_changes(toy):
    """Changes that no commit has are refused or told, except in docs/."""
    def git(*words):
        subprocess.run(["git", "-C", str(toy.folder), "-c", "user.name=a", "-c", "user.email=a@b",
                        *words], check=True, capture_output=True)

    def origin():
        lines = toy.section("text")
        return " ".join(lines[:lines.index("")])
    source, wrong = toy.folder / "source.cpp", []
    source.write_text("int a;\n", encoding="utf-8")
    git("init", "--quiet")
    git("add", "source.cpp", "bin", "docs")
    git("commit", "--quiet", "--message", "a")
    toy.page.write_text(toy.page.read_text(encoding="utf-8") + "more\n", encoding="utf-8")
    run = toy.run("--section", "text")
    if run.returncode != 0 or not re.search(r"; commit [0-9a-f]{7,}\.\*$", origin()):
        wrong.append(f"a changed page: {run.returncode}, {run.stderr}, {origin()}")
    source.write_text("int b;\n", encoding="utf-8")
    before = toy.page.read_text(encoding="utf-8")
    run = toy.run("--section", "text")
    error = "source.cpp: uncommitted changes: commit them, or go on by --allow-changes\n"
    if run.returncode != 1 or run.stderr != error or toy.page.read_text(encoding="utf-8") != before:
        wrong.append(f"a changed source: {run.returncode}, {run.stderr}")
    run = toy.run("--section", "text", "--allow-changes")
    if run.returncode != 0 or not origin().endswith(" with changes.*"):
        wrong.append(f"--allow-changes: {run.returncode}, {run.stderr}, {origin()}")
    return wrong


def check_origins(page):
    """Each section starts with a line on machine, date and commit."""
    wrong = []
    for name, text in sections_of(page).items():
        first = " ".join(text.partition("\n\n")[0].split())
        match = ORIGIN.match(first)
        try:
            days = [date.fromisoformat(day) for day in match.groups() if day]
        except (AttributeError, ValueError):
            days = []
        if not days or days != sorted(days):
            wrong.append(f"results.md: {name}: not a line on machine, date and commit: {first}")
    return wrong


def check_definitions(definitions, page, tests, benchmarks):
    """tests: {program: its source}; benchmarks: their source."""
    commands = definitions["commands"]
    sections = {name: s for name, s in definitions.items() if name != "commands"}
    shown = sections_of(page)
    wrong = [f"results.md: section {name} is not defined" for name in shown if name not in sections]
    wrong += [f"results.toml: section {name} is not in results.md" for name in sections
              if name not in shown]
    used = {"renderer"}
    for name, section in sections.items():
        for row in section["rows"] + section.get("sentences", []):
            of = row.get("of", section.get("of"))
            used |= {of} if isinstance(of, str) else set(of)
        table = [line for line in shown.get(name, "").splitlines() if line.startswith("|")]
        if table and table[0] != f"| {section['columns']} |":
            wrong.append(f"{name}: other columns than defined: {table[0]}")
        if table and len(table) - 2 != len(section["rows"]):
            wrong.append(f"{name}: {len(table) - 2} rows, {len(section['rows'])} are defined")
    wrong += [f"results.toml: command {name} {why}"
              for names, why in ((used - commands.keys(), "is not defined"),
                                 (commands.keys() - used, "is not used")) for name in names]
    for name, command in commands.items():
        program, chosen = re.sub(r"^(?:[A-Z_]+=\S+ )+", "", command).split()[:2]
        if program == "bench" and f"{chosen}" not in benchmarks:
            wrong.append(f"results.toml: {name}: no such benchmark: {chosen}")
        elif program == "faults":
            of_class, _, case = chosen.partition(".")
            body = re.search(rf"^class {of_class}\b(?s:.*?)(?=^class |\Z)", tests.get(program, ""), re.MULTILINE)
            if not body or f"def {case or 'test_'}" not in body[0]:
                wrong.append(f"results.toml: {name}: no such test: {chosen}")
        elif program not in ("bench", "penumbra"):
            suite, _, case = chosen.partition(".")
            known = [f"{s}.{c}" for s, c in TEST.findall(tests.get(program, ""))]
            if not fnmatch.filter(known, f"{suite.split('/')[-1]}.{case.split('/')[0]}"):
                wrong.append(f"results.toml: {name}: no such test: {chosen}")
    return wrong


def unknown_figures(readme, results):
    """Figures with a unit that stand in one page and not in the other."""
    known = {figure.replace(" ", "") for figure in FIGURE.findall(results)}
    return [f"README.md: {figure} does not stand in docs/results.md"
            for figure in FIGURE.findall(readme) if figure.replace(" ", "") not in known]


def self_test():
    """Faults that the checks of the real pages have to see."""
    definitions = tomllib.loads(
        '[commands]\nrenderer = "penumbra x"\na = "eval P/S.T*/x"\nb = "bench quick"\n'
        '[one]\ncolumns = "a | b"\nof = "a"\nrows = [{ label = "x" }, { of = "b" }]\n')
    page = ("<!-- results:one -->\n*m*\n\n| a | b |\n|---|---|\n| x | 1 |\n| y | 2 |\n"
            "<!-- /results -->\n")

    def check(page, tests="TEST_P(S, Tells) {\n", benchmarks='->Name("x/quick_one")'):
        return check_definitions(definitions, page, {"eval": tests}, benchmarks)
    cases = [
        (0, check(page)),
        (1, check(page + page.replace("one", "two"))),
        (2, check(page.replace(":one", ":two"))),
        (1, check(page.replace("| y | 2 |\n", ""))),
        (1, check(page.replace("| a | b |", "| a | c |"))),
        (1, check(page, tests="TEST(S, Other) {\n")),
        (1, check(page, benchmarks="slow")),
        *((0, check_origins(page.replace("*m*", line))) for line in (
            "*m; 2001-02-03.* Printed by `x`.", "*m, 2 cores; n; 2001-02-03 to 2001-02-04.*",
            "*m; 2001-02-03; commit abcdef0 with\nchanges.*")),
        *((1, check_origins(page.replace("*m*", line))) for line in (
            "*m*", "*2001-02-03; commit abcdef0.*", "*m; 2001-02-33; commit abcdef0.*", "| a | b |",
            "*m; 2001-02-04 to 2001-02-03.*", "*m; 2001-02-03; commit with changes.*",
            "*m; commit abcdef0; 2001-02-03.*", "*m; 2001-02-03; commit abcdef0")),
        (0, unknown_figures("in 3.6 ms, 2 %, and 4 minutes", "| 3.6 ms | 2 % |")),
        (1, unknown_figures("in 3.6 ms", "| 3.5 ms | 13.6 ms | 3.6 % |")),
    ]
    return [f"self-test: case {i}: {lines}" for i, (count, lines) in enumerate(cases)
            if len(lines) != count]


def main(arguments):
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(arguments[0])

    def text(path):
        return path.read_text(encoding="utf-8")
    definitions = tomllib.loads(text(root / "docs" / "results.toml"))
    page = text(root / "docs" / "results.md")
    tests = {folder.name: "".join(text(f) for f in sorted(folder.glob("*_test.cpp")))
             for folder in (root / "tests").iterdir() if folder.is_dir()}
    tests["faults"] = text(root / "tests" / "integration" / "service_faults_test.py")
    benchmarks = "".join(text(f) for f in sorted((root / "tests" / "bench").glob("*.cpp")))
    faults = self_test() + check_script(root)
    faults += check_definitions(definitions, page, tests, benchmarks) + check_origins(page)
    faults += unknown_figures(text(root / "README.md"), page)
    for line in faults:
        print(line, file=sys.stderr)
    if not faults:
        print(f"{len(definitions) - 1} sections of {len(definitions['commands'])} commands")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
