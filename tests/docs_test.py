#!/usr/bin/env python3
"""Fails when the documentation contradicts the repository, or when pages and code are hard to read.

usage: docs_test.py ROOT [BIN_FOLDER]

Checks links, widths of lines (of C++, Python and bash, too), lengths of pages and sentences; that
functions stand in the files that tables name; that tests which tests/measuring_tests.txt names
exist; with BIN_FOLDER, that each flag that the programs know is documented, and no other.
names_test.py checks keys and other names. Every check first runs on made-up faults: one that sees
nothing cannot pass.
"""
import posixpath
import re
import statistics
import subprocess
import sys
from pathlib import Path

PROSE_COLUMNS, TABLE_COLUMNS = 100, 160
# What holds today; 120 is what scripts are meant to keep to.
CODE_COLUMNS = {".cpp": 100, ".h": 100, ".py": 127, ".sh": 121, "bash": 120}
README_LINES, RELEASE_LINES, SENTENCE_WORDS = 120, 40, 18
REFERENCE = "docs/reference/"
COMMAND_LINE = REFERENCE + "command-line.md"
PROGRAMS = ("penumbra", "penumbrad")  # penumbra starts the others
EVERYWHERE = {"-h", "--help", "--version"}  # flags that each program has
NOT_OURS = ("build", "out")

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)[^)]*\)")
LINK_TARGET = re.compile(r"\]\([^)]*\)")
IMAGE = re.compile(r"!\[[^\]]*\]\([^)]*\)")
CODE = re.compile(r"`[^`]*`")
LIST_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s+")
RAW_STRING = re.compile(r'R"(\w*)\(.*?\)\1"', re.DOTALL)
FLAG_LINE = re.compile(r"^ {2}((?:-\w,)?--[\w-]+)", re.MULTILINE)


# ---- Markdown. ----

def lines_of(text):
    """(number, kind, line) of each line; kind: code, table, heading, blank or prose."""
    fence = None
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r"\s*(```|~~~|\$\$)", line)
        if fence or mark:
            yield number, "code", line
            closed = mark and mark[1] == fence if fence else line.count("$$") > 1
            fence = None if closed else fence or mark[1]
        elif not line.strip():
            yield number, "blank", line
        elif line.startswith("|"):
            yield number, "table", line
        else:
            yield number, "heading" if line.startswith("#") else "prose", line


def anchors_of(text):
    """Anchors of a page's headings, as GitHub makes them."""
    out = set()
    for _, kind, line in lines_of(text):
        if kind != "heading":
            continue
        title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", line.lstrip("#").strip())
        slug = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        numbered = (slug if n == 0 else f"{slug}-{n}" for n in range(len(out) + 1))
        out.add(next(s for s in numbered if s not in out))
    return out


def tables_of(text):
    """(heading above, first column, line, [(line, first cell)]) of each table."""
    heading, before, out = "", "blank", []
    for number, kind, line in lines_of(text):
        if kind == "heading":
            heading = line.lstrip("#").strip()
        if kind == "table":
            first = line.strip("|").split("|")[0].strip()
            if before != "table":
                out.append((heading, first, number, []))
            elif not first.startswith("-"):
                out[-1][3].append((number, first))
        before = kind
    return out


# ---- The checks: each gives lines `file:line: reason`. ----

def broken_links(pages, exists):
    """pages: {path: text}; exists(path) tells whether a file or folder is there."""
    found = []
    for path, text in pages.items():
        for number, kind, line in lines_of(text):
            if kind == "code":
                continue
            for target in LINK.findall(CODE.sub("code", line)):
                if re.match(r"[a-z]+:", target):
                    continue
                name, _, anchor = target.partition("#")
                file = posixpath.normpath(posixpath.join(posixpath.dirname(path), name))
                file = file if name else path
                if not exists(file):
                    found.append(f"{path}:{number}: {target}: no such file")
                elif anchor and anchor not in anchors_of(pages.get(file, "")):
                    found.append(f"{path}:{number}: {target}: no such heading")
    return found


def wide_lines(path, text):
    found = []
    for number, kind, line in lines_of(text):
        columns = 0 if kind == "code" else len(LINK_TARGET.sub("]", line))
        most = TABLE_COLUMNS if kind == "table" else PROSE_COLUMNS
        if columns > most:
            found.append(f"{path}:{number}: {columns} columns, at most {most}")
    return found


def wide_code(path, text, kind):
    """kind: one of CODE_COLUMNS. What stands in raw strings of C++ does not count."""
    if kind in (".cpp", ".h"):
        text = RAW_STRING.sub(lambda match: 'R"()"' + "\n" * match[0].count("\n"), text)
    return [f"{path}:{number}: {len(line)} columns, at most {CODE_COLUMNS[kind]}"
            for number, line in enumerate(text.split("\n"), 1) if len(line) > CODE_COLUMNS[kind]]


def kind_of_code(path):
    """One of CODE_COLUMNS or nothing; a file without a suffix tells by its first line."""
    if path.suffix or path.read_bytes()[:2] != b"#!":
        return path.suffix
    return path.read_text(encoding="utf-8").split("\n", 1)[0].rpartition(" ")[2]


def missing_functions(path, text, read):
    """Rows of tables `step | function | file` whose file has no such function; read(file) gives its
    text or None."""
    found = []
    for number, kind, line in lines_of(text):
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if kind != "table" or len(cells) != 3 or not re.fullmatch(r"`[\w:]+`", cells[1]):
            continue
        name, file = cells[1].strip("`"), cells[2].strip("`")
        code = read(file)
        own = name if file.endswith(".cpp") else name.rpartition("::")[2]
        if code is None or not re.search(rf"\b{own}\(", code):
            found.append(f"{path}:{number}: {name}: not in {file}")
    return found


def long_pages(path, text):
    lines = text.splitlines()
    if path == "README.md" and len(lines) > README_LINES:
        return [f"{path}:{README_LINES + 1}: {len(lines)} lines, at most {README_LINES}"]
    if path != "CHANGELOG.md":
        return []
    starts = [i for i, line in enumerate(lines) if line.startswith("## ")] + [len(lines)]
    if len(starts) == 1:
        return [f"{path}:1: no release: a heading of two #"]
    return [f"{path}:{start + 1}: {end - start} lines, at most {RELEASE_LINES}"
            for start, end in zip(starts, starts[1:]) if end - start > RELEASE_LINES]


def long_sentences(path, text):
    """By the words of each sentence of the prose, without code, tables and lists of links."""
    paragraphs, before, lengths = [], "blank", []
    for _, kind, line in lines_of(text):
        if kind == "prose" and (before != "prose" or LIST_ITEM.match(line)):
            paragraphs.append("")
        if kind == "prose":
            paragraphs[-1] += " " + IMAGE.sub("", line)
        before = kind
    for paragraph in paragraphs:
        if re.match(LIST_ITEM.pattern + r"\[", paragraph):
            continue
        paragraph = LINK_TARGET.sub("]", CODE.sub("code", LIST_ITEM.sub("", paragraph)))
        for sentence in re.split(r"(?<=[.!?])[*_)\]]*\s+", paragraph):
            lengths.append(sum(bool(re.search(r"\w", word)) for word in sentence.split()))
    median = statistics.median([n for n in lengths if n > 0] or [0])
    too_long = f"{path}:1: median sentence of {median:g} words, at most {SENTENCE_WORDS}"
    return [too_long] if median > SENTENCE_WORDS else []


def documented_flags(text):
    """{command: {flag: line}} of the sections of the command line's page; flag "": the heading."""
    out = {}
    for number, kind, line in lines_of(text):
        command = line.lstrip("#").strip()
        if kind == "heading" and command.startswith(PROGRAMS):
            out[command] = {"": number}
    for heading, first, _, rows in tables_of(text):
        for number, cell in rows if first == "flag" else []:
            out.get(heading, {}).update(dict.fromkeys(re.findall(r"`(--?[\w-]+)`", cell), number))
    return out


def wrong_flags(known, text):
    """known: {command: flags} of the programs."""
    found, documented = [], documented_flags(text)
    for command in sorted(known.keys() | documented.keys()):
        lines = documented.get(command, {"": 1})
        if command not in known or command not in documented:
            why = "no program has it" if command in documented else "has no section"
            found.append(f"{COMMAND_LINE}:{lines['']}: {command}: {why}")
            continue
        for flag in sorted(known[command] ^ (lines.keys() - {""})):
            why = "is not known to the program" if flag in lines else "is not documented"
            found.append(f"{COMMAND_LINE}:{lines.get(flag, lines[''])}: {command} {flag}: {why}")
    return found


def known_flags(bin_folder, command, help_of):
    """{command: flags} of a command and those below it."""
    text = help_of(bin_folder, command)
    flags = {f for names in FLAG_LINE.findall(text) for f in names.split(",")} - EVERYWHERE
    below = re.search(r"^Subcommands:\n((?: {2}.*\n?)*)", text, re.MULTILINE)
    out = {command: flags} if flags or not below else {}
    for name in re.findall(r"^ {2}([\w-]+)", below[1] if below else "", re.MULTILINE):
        out |= known_flags(bin_folder, f"{command} {name}", help_of)
    return out


def help_of(bin_folder, command):
    program, *rest = command.split()
    run = subprocess.run([str(Path(bin_folder) / program), *rest, "--help"], capture_output=True,
                         text=True, check=True, timeout=60)
    return run.stdout


# ---- The checks on made-up pages. ----

def unknown_tests(listed, sources):
    """Names of a list that no source defines. Of parametrised ones the list has Prefix/Suite.Name/*."""
    defined = {f"{suite}.{name}" for text in sources
               for suite, name in re.findall(r"TEST(?:_[FP])?\(\s*(\w+),\s*(\w+)\s*\)", text)}
    names = [line for line in listed.splitlines() if line and not line.startswith("#")]
    return [f"tests/measuring_tests.txt: {name}: there is no such test" for name in names
            if re.sub(r"^\w+/(?=\w+\.)|/\*$", "", name) not in defined]


def self_test():
    page = "# A b `c/d`\n[x](b.md#a-b-cd) [y](#a-b-cd) ![z](p.jpg) `[no](no)`\n```\n[n](n)\n```\n"
    flags = "## penumbra demo\n| flag | type |\n|---|---|\n| `-o`, `--out` | path |\n"
    shown = "Options:\n  -h,--help  Help\n  -o,--out TEXT  Folder\n  --no-x{false}  Off\n"
    tree = {"p": "Options:\n  --version  V\n\nSubcommands:\n  demo   Runs\n  hdr   H\n",
            "p demo": shown, "p hdr": "Subcommands:\n  merge  M\n", "p hdr merge": "  -a,--all  A"}
    sentence = " ".join(["word"] * 19) + ". "

    def has(path):
        return path in {"a.md", "b.md", "p.jpg"}
    right = [
        broken_links({"a.md": page, "b.md": page}, has),
        wide_lines("a.md", f"```\n{'x' * 200}\n```\n[x]({'y' * 100})\n| {'x' * 150} |\n"),
        wide_code("a.cpp", f'f(R"({"x" * 200}\n{"x" * 200})");\n' + "x" * 100, ".cpp"),
        wide_code("a.h", f'R"j({"x" * 200})" )j"\n' + 'R"(")" ' + "x" * 90, ".h"),
        wide_code("a.py", "x" * CODE_COLUMNS[".py"] + "\n" + "ä" * 100, ".py"),
        missing_functions("a.md", "| way | `A::b` | `a.cpp` |\n| x | y | z |\n| x | `b` | `a.cpp` |",
                          lambda _: "int A::b(int)"),
        missing_functions("a.md", "| way | `A::b` | `a.h` |", lambda _: "int b(int)"),
        long_pages("README.md", "x\n" * 120), long_pages("CHANGELOG.md", "# C\n## 1" + "\nx" * 39),
        long_sentences("a.md", "Short. Short.\n\n" + sentence + f"\n\n- [{sentence}](x)\n"),
        wrong_flags({"penumbra demo": {"-o", "--out"}}, flags),
        unknown_tests("# long\nA.B\nAll/C.D/*\n", ["TEST(A, B) {}", "TEST_P(C,\n       D) {"]),
    ]
    wrong = [
        unknown_tests("A.C\n", ["TEST(A, B) {}"]),
        missing_functions("a.md", "| way | `A::c` | `a.cpp` |", lambda _: "int A::b(int)"),
        missing_functions("a.md", "| way | `A::b` | `a.cpp` |", lambda _: None),
        broken_links({"a.md": "[x](no.md)"}, has),
        broken_links({"a.md": "[x](b.md#no)", "b.md": page}, has),
        broken_links({"a.md": "[x](#no)"}, has), broken_links({"a.md": "\n![x](no.jpg)"}, has),
        wide_lines("a.md", "x" * 101), wide_lines("a.md", "| " + "x" * 160),
        *(wide_code("a", "x\n" + "x" * (most + 1), kind) for kind, most in CODE_COLUMNS.items()),
        wide_code("a.h", f'R"({"x" * 9}\n{"x" * 9})" + {"x" * 98}', ".h"),
        wide_code("a.py", f'R"({"x" * 200})"', ".py"), long_pages("README.md", "x\n" * 121),
        long_pages("CHANGELOG.md", "## 1\n" + "x\n" * 40),
        long_pages("CHANGELOG.md", "# C\n- x\n"), long_sentences("a.md", "Short. " + sentence * 2),
        wrong_flags({"penumbra demo": {"-o", "--out", "--new"}}, flags),
        wrong_flags({"penumbra demo": {"-o"}}, flags),
        wrong_flags({"penumbra demo": {"-o", "--out"}, "penumbra x": {"--y"}}, flags),
        wrong_flags({}, flags),
    ]
    out = [f"right case {i}: {lines}" for i, lines in enumerate(right) if lines]
    out += [f"wrong case {i}: {lines}" for i, lines in enumerate(wrong) if len(lines) != 1]
    expected = {"p demo": {"-o", "--out", "--no-x"}, "p hdr merge": {"-a", "--all"}}
    if (known := known_flags("", "p", lambda _, command: tree[command])) != expected:
        out.append(f"flags of help texts: {known}")
    return [f"self-test: {line}" for line in out]


def main(arguments):
    if len(arguments) not in (1, 2):
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(arguments[0])

    tops = [p for p in sorted(root.iterdir())
            if p.name == ".ci" or p.name not in NOT_OURS and p.name[0] != "."]
    files = [f for p in tops for f in ([p] if p.is_file() else sorted(p.rglob("*")))]

    def texts(*kinds):
        return {f.relative_to(root).as_posix(): f.read_text(encoding="utf-8")
                for f in files if f.suffix in kinds}
    def source_of(file):
        return (root / file).read_text(encoding="utf-8") if (root / file).is_file() else None
    pages = texts(".md")
    faults = self_test() + broken_links(pages, lambda path: (root / path).exists())
    for path, text in pages.items():
        faults += wide_lines(path, text) + long_pages(path, text)
        faults += missing_functions(path, text, source_of)
        if path.startswith("docs/") or path in ("README.md", "CONTRIBUTING.md"):
            faults += long_sentences(path, text)
    code = [(f, kind) for f in files if f.is_file() and (kind := kind_of_code(f)) in CODE_COLUMNS]
    for file, kind in code:
        path = file.relative_to(root).as_posix()
        faults += wide_code(path, file.read_text(encoding="utf-8"), kind)
    measuring = root / "tests" / "measuring_tests.txt"
    if measuring.exists():
        faults += unknown_tests(measuring.read_text(encoding="utf-8"), texts(".cpp").values())
    if len(arguments) == 2:
        known = {}
        for program in PROGRAMS:
            known |= known_flags(arguments[1], program, help_of)
        faults += wrong_flags(known, pages.get(COMMAND_LINE, ""))
    for line in faults:
        print(line, file=sys.stderr)
    if not faults:
        print(f"{len(pages)} pages agree with the repository, {len(code)} files of code are read")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
