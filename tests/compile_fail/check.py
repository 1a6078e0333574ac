#!/usr/bin/env python3
"""Proves that a case compiles without -DWRONG, does not with it, and fails for the stated reason.

usage: check.py COMPILER INCLUDE_FOLDER CASE.cpp   or   check.py COMPILER --self-test

A case holds its mistake between `#ifdef WRONG` and the next `#else` or `#endif`; the compiler's
first error must point at a line there. Each comment `// expect: TEXT` names a text that the errors
must hold: a type, since the wording around it differs between compilers.
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path


def compile_case(compiler, include, case, *flags):
    command = [compiler, "-std=c++23", "-fsyntax-only", f"-I{include}", *flags, str(case)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"LC_ALL": "C"})
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


def complaint(compiler, include, case):
    """None when the case holds, else what is wrong with it."""
    text = case.read_text()
    expected = re.findall(r"//\s*expect:\s*(.*\S)", text)
    if not expected or not wrong_lines(text):
        return "has no `// expect:` or nothing under `#ifdef WRONG`"
    status, output = compile_case(compiler, include, case)
    if status != 0:
        return f"the right form does not compile:\n{output}"
    status, output = compile_case(compiler, include, case, "-DWRONG")
    if status == 0:
        return "the wrong form compiles"
    # Without the source lines that the compiler quotes: they carry the expectation itself.
    messages = re.findall(r"^(.+?):(\d+):(?:\d+:)? (error|note): (.*)$", output, re.MULTILINE)
    errors = [(Path(file).name, int(line)) for file, line, kind, _ in messages if kind == "error"]
    if not errors or errors[0][0] != case.name or errors[0][1] not in wrong_lines(text):
        return f"the wrong form fails elsewhere:\n{output}"
    missing = [e for e in expected if not any(e in message for *_, message in messages)]
    if missing:
        return f"the wrong form's errors do not mention {missing}:\n{output}"
    return None


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
        case = Path(folder) / "case.cpp"
        case.write_text(good)
        if (why := complaint(compiler, folder, case)) is not None:
            failed.append(f"good case refused: {why}")
        for name, text in bad.items():
            case.write_text(text)
            if complaint(compiler, folder, case) is None:
                failed.append(f"accepted: {name}")
    return "\n".join(failed) or None


def main(arguments):
    if len(arguments) == 2 and arguments[1] == "--self-test":
        why = self_test(arguments[0])
    elif len(arguments) == 3:
        why = complaint(arguments[0], arguments[1], Path(arguments[2]))
    else:
        why = __doc__
    if why:
        print(f"{arguments[-1] if arguments else 'check.py'}: {why}", file=sys.stderr)
    return 1 if why else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
