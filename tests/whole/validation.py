#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Makes docs/validation.md: what gieson errs by, measured on inputs whose truth is known.

    validation.py BUILD > docs/validation.md    runs everything, some ten minutes on two cores
    validation.py BUILD --check                 is every program there that it would run?

Each block of the page is what a command printed, without the test runner's own lines, beneath the
command itself; nothing is typed by hand. The number of trials stands in the command: more of them
narrow the figures, and take longer."""
import datetime
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile

LIMIT_S = 1800

# heading, what is asked, (command with the programs' folder as BIN and the tests' as TESTS)
MEASURED = [
    ("Loss", "A control and a treated specimen are drawn, with a calibration panel, and taken from panels to "
     "reports. [Method](method/loss.md).", "BIN/gieson demo demo"),
    ("Panel", "One to four sections are lost from drawn panels of any layout. Is the gap seen where it is? "
     "[Method](method/panel.md).", "GIESON_TRIALS=400 TESTS/test_register_lost"),
    ("Fiducials and pose: faces", "A section lies face down among others at any angle, marks are lost, and spots "
     "are there that are no marks. [Method](method/pose.md).",
     "GIESON_TRIALS=100 TESTS/test_register_mirrored"),
    ("Pose: outliers", "One mark of three is off by 12 standard deviations; flips near the least asymmetry that "
     "tells them. [Method](method/pose.md).", "TESTS/test_register_pose_outliers_found"),
    ("Order: a section mounted twice", "[Method](method/order.md).",
     "GIESON_TRIALS=60 TESTS/test_register_order_duplicate"),
    ("Volumes of the tissue", "Stacks with a grain of their own on the phantom's density; registration and stain "
     "without error. [Method](method/volumes.md).",
     "GIESON_SEEDS=2 TESTS/test_measure_tissue_volume"),
]
RUNNER = re.compile(r"^\[[ =A-Z]+\]|^\s*$|^demo: |: \d+ panels taken")


def programs_of(build):
    return {"BIN": build / "bin", "TESTS": build / "tests"}


def fill(command, build):
    for word, folder in programs_of(build).items():
        command = command.replace(word + "/", f"{folder}/")
    return command


def missing(build):
    for _, _, command in MEASURED:
        program = next(word for word in shlex.split(fill(command, build)) if "=" not in word)
        if not os.access(program, os.X_OK):
            yield f"{program} is not there"


def run(command, build):
    with tempfile.TemporaryDirectory(prefix="gieson-validation-") as folder:
        done = subprocess.run(["sh", "-c", fill(command, build)], cwd=folder, capture_output=True, text=True,
                              errors="replace", timeout=LIMIT_S)
    lines = [line.rstrip() for line in (done.stdout + done.stderr).splitlines() if not RUNNER.match(line)]
    if done.returncode != 0:
        lines.append(f"(ended with {done.returncode})")
    return "\n".join(lines)


def describe(root):
    commit = subprocess.run(["git", "-C", str(root), "rev-parse", "--short", "HEAD"], capture_output=True,
                            text=True).stdout.strip() or "an unknown commit"
    cpu = re.search(r"model name\s*: (.*)", pathlib.Path("/proc/cpuinfo").read_text())
    return (f"{datetime.datetime.now(datetime.timezone.utc):%d %B %Y}, commit {commit}, "
            f"{cpu.group(1) if cpu else 'an unknown processor'}")


def main():
    build = pathlib.Path(sys.argv[1]).resolve()
    root = pathlib.Path(__file__).resolve().parents[2]
    absent = list(missing(build))
    if absent or "--check" in sys.argv[2:]:
        print("\n".join(absent) or "all programs are there")
        return 1 if absent else 0
    print("# Validation\n\nEvery block is what the command above it printed. "
          "`tests/whole/validation.py build/bench > docs/validation.md`\nmakes this page again.\n\n"
          f"Measured: {describe(root)}.")
    for heading, question, command in MEASURED:
        print(f"\n## {heading}\n\n{question}\n\n    {command}\n\n```text\n{run(command, build)}\n```", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
