#!/usr/bin/env python3
"""Makes the tables of docs/results.md from what the commands of docs/results.toml print.

usage: results.py [--build FOLDER] [--section NAME...] [--from FOLDER] [--allow-changes]

Each command runs once. Its output is kept in out/results/NAME.txt, behind a line on machine, date
and commit; what it writes is kept in out/results/NAME/. A section is written when all its figures
are there. A command that fails, or prints no such figure, is an error that names section, row and
command. Where shared data is absent, the section stays as it is. A commit stands for what was
measured, so files changed since are an error, except in docs/. Run on an idle machine.
"""
import argparse
import csv
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import time
import tomllib
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
KEPT = ROOT / "out" / "results"
WIDTH = 100
PRINTED_BY = "printed by"


class Wrong(Exception):
    """A figure that cannot be had: an error."""


class Absent(Exception):
    """Data that is not on this machine: the section stays."""


class Values(list):
    """The figures of one name. Formatting shows the only one, or what all are."""
    cases = property(len)
    mean = property(lambda self: sum(self) / len(self))
    median = property(lambda self: sorted(self)[len(self) // 2])
    min = property(lambda self: min(self))
    max = property(lambda self: max(self))
    worst = property(lambda self: max(self, key=abs))
    largest = property(lambda self: abs(self.worst))
    percent = property(lambda self: Values(100 * v for v in self))
    mega = property(lambda self: Values(1e-6 * v for v in self))

    def __format__(self, spec):
        if len(set(self)) != 1:
            raise ValueError(f"{len(self)} figures where one is shown")
        return format(self[0], spec)


# ---- Figures out of outputs. ----

def find(text, row):
    """[{group: figure}] of all matches."""
    pattern = row["find"].replace("NAME", row.get("name", ""))
    return [match.groupdict() for match in re.finditer(pattern, text, re.MULTILINE)]


def number(cell):
    try:
        return float(cell) if math.isfinite(float(cell)) else None
    except (TypeError, ValueError):
        return None


def fits(row, where):
    """Whether a row of a table has these texts, by regular expressions, and numbers."""
    return all(re.fullmatch(wanted, str(row.get(column))) if isinstance(wanted, str)
               else number(row.get(column)) == wanted for column, wanted in where.items())


def divided(row, others):
    """A row by the only one of `others`, column by column."""
    if len(others) != 1:
        return {}
    both = {c: (number(row[c]), number(others[0][c])) for c in row}
    return {c: a / b for c, (a, b) in both.items() if a is not None and b}


def at_value(rows, column, value):
    """One row, on the straight lines between the logarithms of two neighbours."""
    known = [row for row in rows if (number(row[column]) or 0) > 0]
    known.sort(key=lambda row: number(row[column]))
    for a, b in zip(known, known[1:]):
        low, high = number(a[column]), number(b[column])
        if low <= value <= high and low < high:
            t = math.log(value / low) / math.log(high / low)
            pairs = {c: (number(a[c]), number(b[c])) for c in a}
            return [{c: math.exp((1 - t) * math.log(x) + t * math.log(y))
                     for c, (x, y) in pairs.items() if x and y and x > 0 and y > 0}]
    return []


def columns_of(rows):
    out = {}
    for row in rows:
        for column, cell in row.items():
            if (value := number(cell)) is not None:
                out.setdefault(column, Values()).append(value)
    return out


def select(rows, row):
    """The rows of a table that the definition asks for."""
    where = {**row.get("sets", {}).get(row.get("set"), {}), **row["where"]}
    out = [r for r in rows if fits(r, where)]
    if row.get("over"):
        below = [r for r in rows if fits(r, row["over"])]
        out = [divided(r, [b for b in below if all(r[c] == b[c] for c in row["by"])]) for r in out]
    for column, value in row.get("at", {}).items():
        out = at_value(out, column, value)
    return out


# ---- Commands and what is kept of them. ----

# What stands for several files of the shared data: their folder, their names, the flag before each.
SEVERAL = {"{maps}": ("envmaps", ["*_1k.hdr"], None),
           "{meshes}": ("eval-only/meshes", ["*.obj", "dragon.ply"], "--asset"),
           "{scans}": ("eval-only/meshes", ["stanford-bunny.obj", "dragon.ply"], "--asset")}


def shared_files(placeholder):
    folder, patterns, flag = SEVERAL[placeholder]
    shared = Path(os.environ.get("PENUMBRA_SHARED_DATA") or ROOT / ".." / "shared" / "data")
    files = sorted(str(path) for name in patterns for path in (shared / folder).glob(name))
    if not files:
        raise Absent(f"shared data folder absent: {folder} (set PENUMBRA_SHARED_DATA)")
    return [word for file in files for word in ([flag, file] if flag else [file])]


def arguments_of(command, binaries, folder):
    """(argument list, added environment) of a command as docs/results.toml writes it."""
    words, added = shlex.split(command), {}
    while re.match(r"[A-Z_]+=", words[0]):
        name, _, added[name] = words.pop(0).partition("=")
    program, *rest = words
    if program == "bench":
        rest = [f"--benchmark_filter={rest[0]}", "--benchmark_format=json"]
        program = "penumbra_bench"
    elif program == "faults":
        test = ROOT / "tests" / "integration" / "service_faults_test.py"
        return [sys.executable, str(test), str(binaries / "penumbrad"), *rest], added
    elif program != "penumbra":
        rest = [f"--gtest_filter={rest[0]}"]
        program += "_test"
    out = [str(binaries / program)]
    for word in rest:
        out += shared_files(word) if word in SEVERAL else [word.replace("{out}", str(folder))]
    return out, added


def shown(command):
    """A command as readers type it."""
    for hidden, instead in ((" --out {out}", ""), (" -o {out}.glb", ""), (" --json", ""),
                            ("{maps}", "MAPS"),
                            ("{meshes}", "--asset MESHES"), ("{scans}", "--asset SCANS")):
        command = command.replace(hidden, instead)
    return f"`{command}`"


def git(*arguments):
    run = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True)
    return run.stdout.strip() if run.returncode == 0 else ""


def changed_files():
    """Tracked files outside of docs/ that are not as the commit has them."""
    return git("diff", "--name-only", "HEAD", "--", ".", ":!docs").splitlines()


class Outputs:
    """What commands printed: kept, or run now."""

    def __init__(self, commands, binaries, source):
        self.commands, self.binaries, self.source = commands, binaries, source
        self.read = {}  # name: (text, origin)
        self.this = None

    def is_kept(self, name):
        return self.source and any((self.source / n).exists() for n in (f"{name}.txt", name))

    def folder(self, name):
        """Where the files of a command stand."""
        return (self.source if self.is_kept(name) else KEPT) / name

    def get(self, name):
        """(text, origin); the origin says machine, date and commit."""
        if name not in self.read:
            folder = self.folder(name)
            self.read[name] = self.load(folder) if self.is_kept(name) else self.run(name, folder)
        return self.read[name]

    def load(self, folder):
        file = folder.with_suffix(".txt")
        text = file.read_text(encoding="utf-8") if file.exists() else ""
        first, _, rest = text.partition("\n")
        if first.startswith("# {"):
            return rest, json.loads(first[2:])
        # Made by hand, on this machine.
        day = date.fromtimestamp((file if file.exists() else folder).stat().st_mtime)
        return text, {**self.origin(), "date": day.isoformat()}

    def run(self, name, folder):
        command = self.commands[name]
        words, added = arguments_of(command, self.binaries, folder)
        origin = self.origin() if name != "renderer" else {}
        print(f"  {shown(command)} ... ", end="", flush=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        start = time.monotonic()
        try:
            run = subprocess.run(words, capture_output=True, text=True, errors="replace", cwd=ROOT,
                                 env={**os.environ, **added})
        except OSError as error:
            print("does not start")
            raise Wrong(f"{words[0]}: {error.strerror}") from error
        print(f"{time.monotonic() - start:.0f} s", flush=True)
        if run.returncode != 0:
            failed = folder.with_suffix(".failed.txt")
            failed.write_text(run.stdout + run.stderr, encoding="utf-8")
            raise Wrong(f"ends with status {run.returncode}, see {failed.relative_to(ROOT)}")
        text = f"# {json.dumps(origin)}\n{run.stdout}"
        folder.with_suffix(".txt").write_text(text, encoding="utf-8")
        return run.stdout, origin

    def has_gpu(self):
        return not any(none in self.origin()["machine"] for none in ("no GPU", "no OpenGL"))

    def origin(self):
        if self.this is None:
            try:
                shown_by, _ = self.run("renderer", KEPT / "renderer")
                renderer = json.loads(shown_by)["configuration"]["renderer"]
            except Wrong:
                renderer = "no OpenGL ES 3.1"
            commit = git("rev-parse", "--short", "HEAD")
            renderer = "llvmpipe (no GPU)" if "llvmpipe" in renderer else renderer
            cores = len(os.sched_getaffinity(0))
            cores = f"{cores} core{'s' if cores > 1 else ''}"
            self.this = {"machine": f"{processor()}, {cores}, {renderer}",
                         "date": date.today().isoformat(),
                         "commit": commit + (" with changes" if changed_files() else "")}
        return self.this


def processor():
    """Its model's name, and the numbers that tell models of one name apart."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    known = dict(re.split(r"\s*:\s*", line, 1) for line in lines if ":" in line)
    name = known.get("model name", "unknown processor")
    if "cpu family" not in known:
        return name
    return f"{name} (family {known['cpu family']}, model {known['model']})"


# ---- Sections. ----

def figures_of(row, outputs):
    """What a row's `show` may name."""
    out = {}
    for name in row["of"]:
        text, _ = outputs.get(name)
        expected = row.get("matches")
        if "find" in row:
            rows, expected = find(text, row), expected or 1
        elif "where" not in row:
            out[name] = json.loads(text)
            continue
        elif row.get("table"):
            with (outputs.folder(name) / row["table"]).open(encoding="utf-8", newline="") as file:
                rows = select(list(csv.DictReader(file)), row)
        else:
            rows = select(json.loads(text)["benchmarks"], row)
        skipped = re.search(r"^\S+:\d+: Skipped\n(.*)$", text, re.MULTILINE)
        if not rows and skipped:
            raise Absent(skipped[1].strip())
        if not rows:
            raise Wrong("prints no such figure")
        if expected not in (None, len(rows)):
            raise Wrong(f"prints {len(rows)} such figures instead of {expected}")
        out |= columns_of(rows)
    return out


def line_of(name, row, outputs, commands):
    """One line of the table, or one sentence when the row has no label."""
    by = ", ".join(shown(commands[n]) for n in row["of"])
    try:
        figures = figures_of(row, outputs)
        show = row["show"].replace("NAME", row.get("name", "")).format(**figures)
        if "label" not in row:
            return show
        cells = [row["label"].format(**figures), show]
    except (Wrong, LookupError, AttributeError, ValueError, TypeError, OSError) as error:
        what = str(error) if isinstance(error, Wrong) else f"{type(error).__name__}: {error}"
        raise Wrong(f"{name}: {row.get('label', 'sentence')}: {by}: {what}") from error
    if row["columns"].endswith(PRINTED_BY):
        cells.append(by)
    return re.sub(r" +", " ", f"| {' | '.join(cells)} |")


def told(origins, commands):
    """Where the figures come from."""
    machines, days, commits = (sorted({origin[key] for origin in origins})
                               for key in ("machine", "date", "commit"))
    words = [*machines, " to ".join(dict.fromkeys([days[0], days[-1]])),
             *(f"commit {c}" for c in commits if c)]
    line = f"*{'; '.join(words)}.*"
    return f"{line} Printed by {' and '.join(commands)}." if commands else line


def wrapped(prose):
    """Lines of prose, with no break in a command or before a %."""
    held = re.sub(r"`[^`]*`| %", lambda match: match[0].replace(" ", "\u00a0"), prose)
    lines = textwrap.fill(held, WIDTH, break_long_words=False, break_on_hyphens=False)
    return lines.replace("\u00a0", " ")


def section_text(name, section, outputs, commands):
    """What stands between the marks of a section."""
    def whole(row):
        row = {**section, **row}
        return {**row, "of": [row["of"]] if isinstance(row["of"], str) else row["of"]}
    rows, sentences = ([whole(r) for r in section.get(kind, [])] for kind in ("rows", "sentences"))
    used = list(dict.fromkeys(n for row in rows + sentences for n in row["of"]))
    if section.get("gpu") and not all(outputs.is_kept(n) for n in used) and not outputs.has_gpu():
        raise Absent("needs a GPU")
    table = [line_of(name, row, outputs, commands) for row in rows]
    prose = " ".join(line_of(name, row, outputs, commands) for row in sentences)
    by = [] if section["columns"].endswith(PRINTED_BY) else [shown(commands[n]) for n in used]
    head = [f"| {section['columns']} |", "|" + "---|" * (section["columns"].count("|") + 1)]
    paragraphs = [told([outputs.get(n)[1] for n in used], by), prose]
    return "\n".join([*(wrapped(p) + "\n" for p in paragraphs if p), *head, *table])


def write_section(page, name, text):
    """Replaces a section at once or not at all."""
    mark = rf"(<!-- results:{re.escape(name)} -->\n).*?(<!-- /results -->)"
    new, count = re.subn(mark, lambda m: f"{m[1]}{text}\n{m[2]}",
                         page.read_text(encoding="utf-8"), flags=re.DOTALL)
    if count != 1:
        raise Wrong(f"{name}: {page} has {count} sections of this name")
    work = page.with_suffix(".tmp")
    work.write_text(new, encoding="utf-8")
    os.replace(work, page)


def copy_files(section, outputs):
    for source, target in section.get("copy", {}).items():
        name, _, file = source.partition("/")
        path = outputs.folder(name) / file
        if path.exists():
            shutil.copyfile(path, DOCS / target)
        else:
            print(f"  {path} is not there: docs/{target} stays as it is")


# ---- Plots. ----

def points_of(panel, plot, outputs):
    """[(x, y)] of the benchmarks that a panel names, by x."""
    rows = json.loads(outputs.get(plot["of"])[0])["benchmarks"]
    out = []
    for case in panel["cases"]:
        found = [r for r in rows if fits(r, {"name": case})]
        if len(found) != 1:
            raise Wrong(f"{case}: {len(found)} benchmarks of this name")
        out.append((found[0][panel["x"]], found[0][plot["y"]]))
    return sorted(out)


def plot_script(plot, outputs):
    """Panels side by side, each with a line of what would grow in proportion."""
    script = ["set encoding utf8",
              f"set terminal svg size {330 * len(plot['panels'])},320 font 'sans-serif,12' "
              "background '#ffffff' noenhanced",
              f"set multiplot layout 1,{len(plot['panels'])}",
              "set grid lw .8 lc rgb '#cccccc'", "set border lw .8", "set key top left Left reverse",
              f"set ylabel '{plot['label']}'"]
    for panel in plot["panels"]:
        points = points_of(panel, plot, outputs)
        (x, y), (x_max, y_max) = points[0], (max(p[k] for p in points) for k in (0, 1))
        script += ["$points << END", *(f"{a} {b}" for a, b in points), "END",
                   f"set xlabel '{panel['label']}'",
                   f"set xrange [0:{1.05 * x_max}]",
                   f"set yrange [0:{1.3 * max(y_max, y * x_max / x)}]",
                   f"set xtics {panel['tics']}" if "tics" in panel else "set xtics auto",
                   f"plot {y / x} * x with lines dt 2 lc rgb '#666666' title 'in proportion', "
                   "$points with linespoints pt 7 lw 1.6 lc rgb '#0072B2' title 'measured'",
                   "set ylabel ''"]
    return "\n".join(script) + "\n"


def draw_plot(name, section, outputs):
    plot = section.get("plot")
    if not plot:
        return
    try:
        script = plot_script(plot, outputs)
        run = subprocess.run(["gnuplot"], input=script, capture_output=True, text=True)
    except Wrong as error:
        raise Wrong(f"{name}: {plot['file']}: {error}") from error
    except OSError:
        print(f"  no gnuplot: docs/{plot['file']} stays as it is")
        return
    if run.returncode != 0:
        raise Wrong(f"{name}: {plot['file']}: {run.stderr.strip()}")
    (DOCS / plot["file"]).write_text(run.stdout, encoding="utf-8")


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "release", metavar="FOLDER",
                        help="built programs and tests; by default build/release")
    parser.add_argument("--section", nargs="+", metavar="NAME", help="only these sections")
    parser.add_argument("--from", dest="source", type=Path, metavar="FOLDER",
                        help="take the outputs kept there, and run only commands without one")
    parser.add_argument("--allow-changes", action="store_true",
                        help="go on with uncommitted changes; the tables say so")
    options = parser.parse_args(arguments)
    if (changed := changed_files()) and not options.allow_changes:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        print(f"{changed[0]}{more}: uncommitted changes: commit them, or go on by --allow-changes",
              file=sys.stderr)
        return 1
    sections = tomllib.loads((DOCS / "results.toml").read_text(encoding="utf-8"))
    commands = sections.pop("commands")
    outputs = Outputs(commands, options.build.resolve() / "bin",
                      options.source and options.source.resolve())
    status = 0
    for name in options.section or sections:
        print(name, flush=True)
        try:
            if name not in sections:
                raise Wrong(f"{name}: no such section; there are {', '.join(sections)}")
            text = section_text(name, sections[name], outputs, commands)
            draw_plot(name, sections[name], outputs)
            write_section(DOCS / "results.md", name, text)
            copy_files(sections[name], outputs)
        except Absent as reason:
            print(f"{name}: stays as it is: {reason}")
        except Wrong as error:
            print(error, file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
