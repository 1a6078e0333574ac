#!/usr/bin/env python3
"""Fails when a program of the product links evaluation or a solver.

usage: symbols_test.py CHART CHART_ARCHIVE CALIBRATE CALIB_ARCHIVE PROGRAM...

Each archive's own functions may be in no PROGRAM. CHART and CALIBRATE must show some of them: a check
that sees nothing cannot pass.
"""
import re
import subprocess
import sys

CODE = re.compile(r"^[0-9a-f]* [Tt] (penumbra::[\w:]*\w)\(")


def symbols(file):
    return subprocess.run(["nm", "-C", "--defined-only", file], text=True, capture_output=True,
                          check=True).stdout


def functions(file):
    """By name; templates, inline ones and unnamed ones, which every object has for itself, are left
    out."""
    return {found[1] for line in symbols(file).splitlines() if (found := CODE.match(line))}


def main(chart, chart_archive, calibrate, calib_archive, *programs):
    faults = []
    evaluation, solvers = functions(chart_archive), functions(calib_archive)
    for program, own in ((chart, evaluation), (calibrate, solvers)):
        if len(own & functions(program)) < 5:
            faults.append(f"{program}: shows nothing of its archive: the check is blind")
    if "ceres::" not in symbols(calibrate):
        faults.append(f"{calibrate}: shows no Ceres: the check is blind")
    for program in programs:
        shown = functions(program)
        if not shown:
            faults.append(f"{program}: shows no functions: the check is blind")
        faults += [f"{program}: links {name}" for name in sorted(shown & (evaluation | solvers))]
        if "ceres::" in symbols(program):
            faults.append(f"{program}: links Ceres")
    for line in faults:
        print(line, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
