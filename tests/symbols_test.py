#!/usr/bin/env python3
"""Fails when a program of the product links evaluation, a solver or plots.

usage: symbols_test.py --chart PROGRAM ARCHIVE... --calibrate PROGRAM ARCHIVE --plots ARCHIVE
                       --product PROGRAM...

The functions of the chart's archives may be in no product and not in --calibrate, those of the
solvers' and the plots' archive in no product. The chart must show some of each of its archives and
of the plots, and so must --calibrate: a check that sees nothing cannot pass.
"""
import argparse
import re
import subprocess
import sys

# In an archive what others may call, in a program hidden functions, too. Clones that the compiler
# makes of inline functions are hidden everywhere.
OFFERED = re.compile(r"^[0-9a-f]* T (penumbra::[\w:]*\w)\(")
LINKED = re.compile(r"^[0-9a-f]* [Tt] (penumbra::[\w:]*\w)\(")
MIN_SHOWN = 3  # functions of an archive


def symbols(file):
    return subprocess.run(["nm", "-C", "--defined-only", file], text=True, capture_output=True,
                          check=True).stdout


def functions(file, code=LINKED):
    """By name; templates, inline ones and unnamed ones, which every object has for itself, are left
    out."""
    return {found[1] for line in symbols(file).splitlines() if (found := code.match(line))}


def of_archives(program, archives, faults):
    """The archives' functions, of each of which the program must show some."""
    shown, out = functions(program), set()
    for archive in archives:
        own = functions(archive, OFFERED)
        if len(own & shown) < MIN_SHOWN:
            faults.append(f"{program}: shows nothing of {archive}: the check is blind")
        out |= own
    return out


def main(arguments):
    parser = argparse.ArgumentParser(usage=__doc__)
    for name in ("--chart", "--calibrate", "--plots", "--product"):
        parser.add_argument(name, nargs="+", required=True)
    options = parser.parse_args(arguments)
    faults = []
    evaluation = of_archives(options.chart[0], options.chart[1:], faults)
    calibrate = options.calibrate[0]
    solvers = of_archives(calibrate, options.calibrate[1:], faults)
    plots = of_archives(calibrate, options.plots, faults)
    of_archives(options.chart[0], options.plots, faults)
    if "ceres::" not in symbols(calibrate):
        faults.append(f"{calibrate}: shows no Ceres: the check is blind")
    for program in [calibrate] + options.product:
        shown = functions(program)
        if not shown:
            faults.append(f"{program}: shows no functions: the check is blind")
        faults += [f"{program}: links {name}" for name in sorted(shown & evaluation)]
    for program in options.product:
        faults += [f"{program}: links {name}"
                   for name in sorted(functions(program) & (solvers | plots))]
        if "ceres::" in symbols(program):
            faults.append(f"{program}: links Ceres")
    for line in faults:
        print(line, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
