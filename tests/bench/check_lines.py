#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""gieson-bench --quick runs, and every line of it is what bench.h promises. No figure is judged:
a speed is no truth about the program.

    check_lines.py PROGRAM
"""
import json
import subprocess
import sys

KEYS = ("measure", "value", "unit", "against", "ratio")
# Measures that have to come, and at least how often.
EXPECTED = {"machine_peak": 1, "machine_triad": 1, "plain": 9, "memoised": 3, "resample": 12,
            "resample_agreement": 3, "resample_threads": 3, "resample_slope": 3, "vtk": 1,
            "rays_linear": 3, "rays_projected": 1, "rays_projected_xray": 1, "rays_xray": 1, "rays_light": 1, "rays_threads": 1, "rays_slope": 1,
            "kernel": 1, "eval_one_by_one": 6, "eval_many": 6, "locate": 2, "mean": 3, "memory": 3,
            "make_space": 3, "make_spline": 3, "fit_assembly": 6, "fit": 6, "fit_slope": 2,
            "ingest_log": 3, "slice_log": 2, "ingest_hash": 1, "ingest_total": 1,
            "decode": 10, "decode_imread": 10, "panel_split": 1, "panel_chain": 1,
             "panel_density": 1, "panel_masks": 1}


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def faults(line):
    """What is wrong with one object."""
    for key in KEYS:
        if key not in line:
            yield f"no {key}"
            return
    if not isinstance(line["measure"], str) or not isinstance(line["unit"], str):
        yield "measure and unit are words"
    if not (line["against"] is None or isinstance(line["against"], str)):
        yield "against is a word or null"
    if not (line["ratio"] is None or is_number(line["ratio"])):
        yield "ratio is a number or null"
    if line["ratio"] is not None and line["against"] is None:
        yield "a ratio against nothing"
    if not is_number(line["value"]) and "skipped" not in line:
        yield "value is a number unless the line says why it is skipped"


def main():
    run = subprocess.run([sys.argv[1], "--quick"], stdout=subprocess.PIPE, text=True, check=False)
    if run.returncode != 0:
        print(f"gieson-bench --quick ended with {run.returncode}")
        return 1
    bad, seen = [], {}
    for number, text in enumerate(run.stdout.splitlines(), 1):
        line = json.loads(text)
        bad += [f"line {number}: {fault}: {text}" for fault in faults(line)]
        seen[line.get("measure")] = seen.get(line.get("measure"), 0) + 1
        if "skipped" in line:
            print(f"SKIPPED {line['measure']}: {line['skipped']}")
    bad += [f"{seen.get(name, 0)} lines of {name}, not {least}" for name, least in EXPECTED.items()
            if seen.get(name, 0) < least]
    unknown = subprocess.run([sys.argv[1], "nonsense"], stderr=subprocess.PIPE, text=True,
                             check=False)
    if unknown.returncode != 64 or "nonsense" not in unknown.stderr:
        bad.append("a measure that does not exist is not refused by name")
    print("\n".join(bad) if bad else f"{sum(seen.values())} lines, all as promised")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
