#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Computes a second time where each laser mark is seen, from the pose, the warp and the defects.

    recompute_marks.py TRUTH_DIR [--within PX]

Reads truth.json and warp_kNNN.csv, evaluates the way from the panel to the block and searches its
inverse by Newton's method with differences, which shares nothing with the fixed-point iteration of
the program that made the phantom; compares with markers.csv. Also checks that sections.csv has the
poses of truth.json and that each warp has the root mean square length that its level declares.
Exit status 1 if anything differs by more than --within pixels.
"""
import argparse
import csv
import json
import math
import pathlib
import sys


def rows_of(path):
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


class Warp:
    """n(p), bilinear on 33 x 33 nodes; None of it is nothing."""

    def __init__(self, path):
        self.node = {}
        if not path.exists():
            return
        for row in rows_of(path):
            at = int(row["row"]), int(row["column"])
            self.node[at] = float(row["nx_um"]), float(row["ny_um"])
            if at == (0, 0):
                self.x0, self.y0 = float(row["x_px"]), float(row["y_px"])
            if at == (32, 32):
                self.pitch = (float(row["x_px"]) - self.x0) / 32

    def rms(self):
        return math.sqrt(sum(x * x + y * y for x, y in self.node.values()) / len(self.node))

    def __call__(self, px, py):
        if not self.node:
            return 0.0, 0.0
        u = min(max((px - self.x0) / self.pitch, 0), 32)
        v = min(max((py - self.y0) / self.pitch, 0), 32)
        i, j = min(int(u), 31), min(int(v), 31)
        u, v = u - i, v - j
        return tuple((1 - v) * ((1 - u) * self.node[j, i][c] + u * self.node[j, i + 1][c])
                     + v * ((1 - u) * self.node[j + 1, i][c] + u * self.node[j + 1, i + 1][c])
                     for c in (0, 1))


def shown(section, px_um, warp, rent, px, py):
    """The material under a panel pixel: X(p), read through a tear or a fold."""
    theta = math.radians(section["theta_deg"])
    dx, dy = (px - section["c_px"][0]) * px_um, (py - section["c_px"][1]) * px_um
    x = (math.cos(theta) * dx + math.sin(theta) * dy) / section["sx"]
    y = (math.cos(theta) * dy - math.sin(theta) * dx) / section["sy"]
    n = warp(px, py)
    x, y = (-x if section["flip"] else x) + n[0], y + n[1]
    if rent is None:
        return x, y
    turn = math.radians(rent["turn_deg"])
    c, s = math.cos(turn), math.sin(turn)
    u, v = c * x + s * y, c * y - s * x
    x0, y0 = rent["at_um"]
    if rent["type"] == "tear":
        u -= math.copysign(0.9 * max(0, (v - y0) * rent["slope"]), u - x0)
    elif u > x0 + rent["width_um"]:
        u += 2 * rent["width_um"]
    return c * u - s * v, s * u + c * v


def search(section, px_um, warp, rent, mark, start):
    """Newton's method; the step of the differences is far below a node of the warp."""
    px, py = start
    step = 1e-4
    for _ in range(20):
        x, y = shown(section, px_um, warp, rent, px, py)
        xx, yx = shown(section, px_um, warp, rent, px + step, py)
        xy, yy = shown(section, px_um, warp, rent, px, py + step)
        a, b, c, d = (xx - x) / step, (xy - x) / step, (yx - y) / step, (yy - y) / step
        det = a * d - b * c
        ex, ey = x - mark[0], y - mark[1]
        px -= (d * ex - b * ey) / det
        py -= (a * ey - c * ex) / det
    return px, py


def rent_of(truth, k):
    found = [d for d in truth["defects"] if d["k"] == k and d["type"] in ("tear", "fold")]
    return found[0] if found else None


def check_poses(truth, rows, within):
    worst = 0.0
    for section, row in zip(truth["sections"], rows):
        theta, px_um = math.radians(section["theta_deg"]), truth["px_um"]
        flip = -1 if section["flip"] else 1
        c, s = math.cos(theta) / px_um, math.sin(theta) / px_um
        m = (c * section["sx"] * flip, -s * section["sy"], section["c_px"][0],
             s * section["sx"] * flip, c * section["sy"], section["c_px"][1])
        for x, y in ((-2500, -2000), (2500, 2000)):
            w = [float(row[name]) for name in ("m00", "m01", "m02", "m10", "m11", "m12")]
            worst = max(worst, abs((m[0] - w[0]) * x + (m[1] - w[1]) * y + m[2] - w[2]),
                        abs((m[3] - w[3]) * x + (m[4] - w[4]) * y + m[5] - w[5]))
    print(f"poses: {worst:.2e} px apart at most")
    return worst <= within


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=pathlib.Path)
    options.add_argument("--within", type=float, default=0.001)
    options = options.parse_args()

    with open(options.folder / "truth.json", encoding="utf-8") as file:
        truth = json.load(file)
    nominal = {m["marker"]: m["block_um"] for m in truth["markers"]}
    declared = truth["parameters"]["warp_rms_um"]
    worst, compared, lengths = 0.0, 0, []
    for row in rows_of(options.folder / "markers.csv"):
        k, marker = int(row["k"]), int(row["marker"])
        section = truth["sections"][k]
        if row["visible"] != "1":
            continue
        warp = Warp(options.folder / f"warp_k{k:03}.csv")
        if marker == 1 and declared:
            lengths.append(warp.rms())
        mark = section["marks"][marker - 1]["block_um"] if "marks" in section else nominal[marker]
        start = float(row["x_px"]) + 3, float(row["y_px"]) - 2
        x, y = search(section, truth["px_um"], warp, rent_of(truth, k), mark, start)
        worst = max(worst, math.hypot(x - float(row["x_px"]), y - float(row["y_px"])))
        compared += 1
    print(f"marks: {compared} compared, {worst:.2e} px apart at most")
    good = worst <= options.within and compared >= 60
    if lengths:
        print(f"warp: {min(lengths):.6f} to {max(lengths):.6f} um long (declared {declared})")
        good = good and max(abs(length - declared) for length in lengths) < 1e-6
    good = check_poses(truth, rows_of(options.folder / "sections.csv"), options.within) and good
    return 0 if good else 1


sys.exit(main())
