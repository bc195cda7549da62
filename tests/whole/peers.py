#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Folders of sections with a known truth: how exact and how fast gieson lays them, beside OpenCV.

    peers.py BIN [--seed N]... [--sections N] [--difficulty normal|hard] [--times N] [--keep FOLDER]

BIN is the programs' folder. The generator, the scorer and the peers are those of ../shared/peers.
Times are CPU times of the work after decoding, taken turn about; where other work runs beside,
only their ratio says anything. Without ../shared or OpenCV it says so and ends with 77."""
import argparse
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

SKIPPED = 77
DEBIANS = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]
PEERS = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared")) / "peers"
MARKERS = "cc_small,cc,sbd,sbd_r,hough,hough_r"
RADIUS = 550
# Half of the best peer's.
BAR = 0.5


def lines_of(*command):
    """What a program says: one JSON object a line."""
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [json.loads(line) for line in said.splitlines() if line.startswith("{")]


def register(programs, folder, answer):
    truth = json.loads((folder / "truth.json").read_text())
    marks = ",".join(f"{v:g}" for mark in truth["canonical_markers"] for v in mark)
    with open(answer, "w") as to:
        code = subprocess.run([programs / "gieson", "--json", "register", folder,
                               f"--marks={marks}", "--radius", str(RADIUS)], stdout=to).returncode
    if code not in (0, 65):
        sys.exit(f"gieson register ended with {code}")
    return json.loads(answer.read_text())


def in_frame(off, pose, at):
    """The error at a point of the frame, along the frame's axes."""
    x, y = (row[0] * at[0] + row[1] * at[1] + row[2] for row in off)
    return pose[0][0] * x + pose[1][0] * y, pose[0][1] * x + pose[1][1] * y


def holds(ellipse, error):
    """Whether the ellipse (x, y, half axes, direction of the longer) about its point holds it."""
    major, minor, turn = ellipse[2], ellipse[3], math.radians(ellipse[4])
    along = error[0] * math.cos(turn) + error[1] * math.sin(turn)
    across = error[1] * math.cos(turn) - error[0] * math.sin(turn)
    return (along / major) ** 2 + (across / minor) ** 2 <= 1


def printed_over_true(folder, poses):
    """Of each section its printed error over the one it has, over the disc of RADIUS; the same of
    all together; and the share of true errors that the ellipses hold."""
    grid = [(x * RADIUS / 10, y * RADIUS / 10) for x in range(-10, 11) for y in range(-10, 11)
            if x * x + y * y <= 100]
    ratios, inside, printed, true = [], [], 0, 0
    for section in json.loads((folder / "truth.json").read_text())["slices"]:
        name = section["file"]
        if name not in poses:
            continue
        off = [[a - b for a, b in zip(ours, theirs)]
               for ours, theirs in zip(poses[name], section["matrix"])]
        square = statistics.fmean(sum((row[0] * x + row[1] * y + row[2]) ** 2 for row in off)
                                  for x, y in grid)
        own = poses["gieson"]["section"][name]
        said = own["error_px"]
        ratios.append(said / math.sqrt(square))
        inside += [holds(e, in_frame(off, poses[name], e[:2])) for e in own["ellipse95_px"]]
        printed += said * said
        true += square
    return ratios, math.sqrt(printed / true), statistics.fmean(inside)


def one_set(programs, folder, times):
    """Prints the lines of one folder; whether all bars are met, times left aside."""
    answer = folder / "gieson.json"
    ours, theirs = [], []
    for _ in range(times):
        poses = register(programs, folder, answer)
        ours.append(poses["gieson"]["cpu_ms_per_section"])
        theirs.append(lines_of(DEBIANS, PEERS / "register_opencv.py", folder, "--methods",
                               "cc_small")[0]["ms_per_slice_cpu"])
    score = lines_of(DEBIANS, PEERS / "score.py", "transforms", folder, answer)[0]
    peers = lines_of(DEBIANS, PEERS / "register_opencv.py", folder, "--methods", MARKERS)
    median = min(p["err_px_median"] for p in peers)
    worst = min(p["err_px_max"] for p in peers)
    ratios, whole, held = printed_over_true(folder, poses)
    within = sum(0.5 <= r <= 2 for r in ratios) / max(len(ratios), 1)
    met = (score["failed"] == 0 and score["silently_wrong"] == 0 and
           score["err_px_median"] <= BAR * median and score["err_px_max"] <= BAR * worst)
    print(f"{folder.name}: {score['n']} sections, {score['failed']} lost, "
          f"{score['silently_wrong']} silently wrong (peers lose "
          f"{min(p['failed'] for p in peers)} to {max(p['failed'] for p in peers)})")
    print(f"  error: median {score['err_px_median']:.4f} px, {score['err_px_median'] / median:.3f} "
          f"of the best peer's; largest {score['err_px_max']:.4f} px, "
          f"{score['err_px_max'] / worst:.3f} of the best peer's")
    print(f"  printed error within half and twice the true one: {100 * within:.0f} %; of all "
          f"sections together {whole:.3f} of the true one; the 95 % ellipses hold "
          f"{100 * held:.1f} % of the errors")
    print("  time: " + ", ".join(f"{a:.2f} of {b:.2f} ms ({a / b:.3f})"
                                 for a, b in zip(ours, theirs)) +
          f"; the middle {statistics.median(a / b for a, b in zip(ours, theirs)):.3f} of cc_small")
    return met


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("--seed", type=int, action="append")
    parser.add_argument("--sections", type=int, default=100)
    parser.add_argument("--difficulty", default="hard")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--keep", type=pathlib.Path, help="folder of the sets; made where missing")
    o = parser.parse_args()
    if not PEERS.is_dir():
        print(f"SKIPPED: {PEERS} is not there")
        return SKIPPED
    if subprocess.run([DEBIANS, "-c", "import cv2, numpy"], capture_output=True).returncode != 0:
        print("SKIPPED: python3-opencv is missing")
        return SKIPPED
    met = True
    with tempfile.TemporaryDirectory(prefix="gieson-peers-") as scratch:
        for seed in o.seed or [11]:
            folder = (o.keep or pathlib.Path(scratch)) / f"{o.difficulty}{seed}"
            if not (folder / "truth.json").exists():
                subprocess.run([DEBIANS, PEERS / "gen" / "gen_sections.py", folder, "--n",
                                str(o.sections), "--difficulty", o.difficulty, "--seed", str(seed)],
                               check=True, stdout=subprocess.DEVNULL)
            met &= one_set(o.programs, folder, o.times)
    print("all as it must be" if met else "wrong: a section is lost or wrong, or less exact than "
          "half of the best peer's error")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
