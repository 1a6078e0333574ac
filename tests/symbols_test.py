#!/usr/bin/env python3
"""Fails when evaluation or a solver is linked into a program of the product again.

usage: symbols_test.py CHART CALIBRATE PROGRAM...

CHART and CALIBRATE must show those symbols: a check that sees nothing cannot pass.
"""
import re
import subprocess
import sys

EVALUATION = re.compile(r"penumbra::tools::.*\b(hdr_flip|prove_governor|compare_pictures|"
                        r"encode_rgbe_video|measure_flicker)\b")
SOLVER = re.compile(r"penumbra::calib::calibrate_rig|ceres::")


def symbols(program):
    return subprocess.run(["nm", "-C", program], text=True, capture_output=True, check=True).stdout


def main(chart, calibrate, *programs):
    faults = []
    if not EVALUATION.search(symbols(chart)):
        faults.append(f"{chart}: shows no evaluation: the check is blind")
    if not SOLVER.search(symbols(calibrate)):
        faults.append(f"{calibrate}: shows no solver: the check is blind")
    for program in programs:
        text = symbols(program)
        faults += [f"{program}: links {found[0]}" for pattern in (EVALUATION, SOLVER)
                   if (found := pattern.search(text))]
    for line in faults:
        print(line, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
