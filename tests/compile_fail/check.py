#!/usr/bin/env python3
"""Proves that each case compiles without -DWRONG, does not with it, and fails for the stated reason.

usage: check.py COMPILER INCLUDE_FOLDER CASE.cpp...   or   check.py COMPILER --self-test

A case holds its mistake between `#ifdef WRONG` and the next `#else` or `#endif`; the compiler's
first error in it must point at a line there. Each comment `// expect: TEXT` names a text that its
errors must hold: a type, since the wording around it differs between compilers. All cases are
compiled together, each in a namespace of its own, as their headers take most of the time.
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path


def compile_together(compiler, include, cases, *flags):
    """The compiler's status and what it says, in the places of the cases' own lines."""
    headers, bodies = [], []
    for number, case in enumerate(cases):
        body = []
        for line in case.read_text().splitlines():
            is_include = line.startswith("#include")
            if is_include and line not in headers:
                headers.append(line)
            body.append("" if is_include else line)
        bodies += [f"namespace case_{number} {{", f'#line 1 "{case}"', *body, "}"]
    command = [compiler, "-std=c++23", "-fsyntax-only", "-fmax-errors=0", f"-I{include}", *flags, "-x", "c++", "-"]
    done = subprocess.run(command, input="\n".join(headers + bodies) + "\n", capture_output=True, text=True,
                          env=os.environ | {"LC_ALL": "C"})
    return done.returncode, done.stdout + done.stderr


def wrong_lines(text):
    lines, inside = set(), False
    for number, line in enumerate(text.splitlines(), 1):
        if re.match(r"\s*#\s*ifdef\s+WRONG\b", line):
            inside = True
        elif re.match(r"\s*#\s*(else|endif)\b", line):
            inside = False
        elif inside:
            lines.add(number)
    return lines


def messages_of(output):
    """Errors, each with its notes: file, line, and all their texts. Without the source lines that the
    compiler quotes: they carry the expectation itself."""
    found = []
    for file, line, kind, text in re.findall(r"^(.+?):(\d+):(?:\d+:)? (error|note): (.*)$", output, re.MULTILINE):
        if kind == "error":
            found.append((file, int(line), [text]))
        elif found:
            found[-1][2].append(text)
    return found


def complaint_of(case, errors, output):
    """None when the case holds, else what is wrong with it."""
    text = case.read_text()
    expected = re.findall(r"//\s*expect:\s*(.*\S)", text)
    if not expected or not wrong_lines(text):
        return "has no `// expect:` or nothing under `#ifdef WRONG`"
    own = [(line, texts) for file, line, texts in errors if Path(file).name == case.name]
    if not own:
        return "the wrong form compiles"
    if own[0][0] not in wrong_lines(text):
        return f"the wrong form fails elsewhere:\n{output}"
    missing = [e for e in expected if not any(e in message for _, texts in own for message in texts)]
    if missing:
        return f"the wrong form's errors do not mention {missing}:\n{output}"
    return None


def complaints(compiler, include, cases):
    status, output = compile_together(compiler, include, cases)
    if status != 0:
        return [f"the right forms do not compile:\n{output}"]
    _, output = compile_together(compiler, include, cases, "-DWRONG")
    errors = messages_of(output)
    return [f"{case}: {why}" for case in cases if (why := complaint_of(case, errors, output)) is not None]


def self_test(compiler):
    """The check must refuse every case that proves nothing, or it could not fail."""
    head = "struct A {}; void f(A);\nint main() {\n"
    good = head + "#ifdef WRONG\nf(1);  // expect: A\n#endif\n}\n"
    bad = {
        "wrong form compiles": good.replace("f(1)", "f(A{})"),
        "right form does not compile": good.replace("int main() {\n", "int main() {\nf(2);\n"),
        "fails elsewhere": "struct A {}; void f(A);\n#ifdef WRONG\nusing B = int;\n#else\n"
        "using B = A;\n#endif\nint main() { f(B{}); }  // expect: A\n",
        "another reason": good.replace("expect: A", "expect: Irradiance"),
        "no expectation": good.replace("expect:", ""),
        "no wrong form": good.replace("WRONG", "OTHER"),
    }
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        case, beside = Path(folder) / "case.cpp", Path(folder) / "beside.cpp"
        case.write_text(good)
        beside.write_text(good)
        if why := complaints(compiler, folder, [beside, case]):
            failed.append(f"good cases refused: {why}")
        for name, text in bad.items():
            case.write_text(text)
            # Beside one that fails as it should, which must not stand for it.
            why = complaints(compiler, folder, [beside, case])
            if not why or (name != "right form does not compile" and not why[0].startswith(str(case))):
                failed.append(f"accepted: {name}")
    return failed


def main(arguments):
    if len(arguments) == 2 and arguments[1] == "--self-test":
        why = self_test(arguments[0])
    elif len(arguments) > 2:
        why = complaints(arguments[0], arguments[1], [Path(case) for case in arguments[2:]])
    else:
        why = [__doc__]
    for line in why:
        print(line, file=sys.stderr)
    return 1 if why else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
