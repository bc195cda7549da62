#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What exact marks allow: the error that is left when every visible mark is known exactly.

    registration_floor.py TRUTH_DIR [--between LEAST MOST]

For each section of the region of interest that shows all three marks, and is neither torn nor
folded, the rigid motion that lays the true mark pixels best on the three columns is compared, over
the region, with where the material really lies (pose, size and warp). Prints the root mean
square of the distances in um; exit status 1 when it is not within the range given.
"""
import argparse
import csv
import json
import math
import pathlib
import sys

SECTIONS = range(5, 30)


def rows_of(path):
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def rigid(source, target, mirrored):
    """The rotation and shift, of a mirror image where the section is turned over."""
    if mirrored:
        source = [(-x, y) for x, y in source]
    n = len(source)
    sx, sy = (sum(p[i] for p in source) / n for i in (0, 1))
    tx, ty = (sum(p[i] for p in target) / n for i in (0, 1))
    dot = sum((a - sx) * (u - tx) + (b - sy) * (v - ty)
              for (a, b), (u, v) in zip(source, target))
    cross = sum((a - sx) * (v - ty) - (b - sy) * (u - tx)
                for (a, b), (u, v) in zip(source, target))
    c, s = dot / math.hypot(dot, cross), cross / math.hypot(dot, cross)

    def apply(x, y):
        x = (-x if mirrored else x) - sx
        return c * x - s * (y - sy) + tx, s * x + c * (y - sy) + ty
    return apply


def warp_of(path):
    """n(p) in um at a panel pixel, bilinear and held outside its nodes."""
    node = {(int(r["row"]), int(r["column"])): r for r in rows_of(path)}
    x0, y0 = float(node[0, 0]["x_px"]), float(node[0, 0]["y_px"])
    pitch = (float(node[0, 32]["x_px"]) - x0) / 32

    def at(px, py):
        u, v = (min(max(t / pitch, 0), 32) for t in (px - x0, py - y0))
        i, j = min(int(u), 31), min(int(v), 31)
        u, v = u - i, v - j
        share = (((j, i), (1 - u) * (1 - v)), ((j, i + 1), u * (1 - v)),
                 ((j + 1, i), (1 - u) * v), ((j + 1, i + 1), u * v))
        return [sum(w * float(node[key][name]) for key, w in share)
                for name in ("nx_um", "ny_um")]
    return at


def points(truth, z, step=60):
    """Where the section at z belongs to the region of interest."""
    g, lesion = truth["geometry"], truth["lesion"]
    ox, oy = g["cx"] + g["tx"] * z, g["cy"] + g["ty"] * z
    reach, found = g["region"]["radius"], []
    for j in range(int(2 * reach / step)):
        for i in range(int(2 * reach / step)):
            dx, dy = (i + 0.5) * step - reach, (j + 0.5) * step - reach
            x, y = lesion["centre"][0] + dx, lesion["centre"][1] + dy
            gx, gy = 2 * (x - ox) / g["a"] ** 2, 2 * (y - oy) / g["b"] ** 2
            value = gx * (x - ox) / 2 + gy * (y - oy) / 2 - (z - g["zap"]) / g["Lr"]
            gz = -1 / g["Lr"] - gx * g["tx"] - gy * g["ty"]
            d = value / math.sqrt(gx * gx + gy * gy + gz * gz)
            if math.hypot(dx, dy) <= reach and 0 <= d - g["wpdl"] < g["region"]["depth"]:
                found.append((x, y))
    return found


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=pathlib.Path)
    options.add_argument("--between", type=float, nargs=2, default=(0, math.inf))
    options = options.parse_args()

    with open(options.folder / "truth.json", encoding="utf-8") as file:
        truth = json.load(file)
    px_um = truth["px_um"]
    columns = {str(m["marker"]): m["block_um"] for m in truth["markers"]}
    marks = rows_of(options.folder / "markers.csv")
    sections = {int(row["k"]): row for row in rows_of(options.folder / "sections.csv")}
    squares, count, used = 0.0, 0, 0
    for k in SECTIONS:
        row = sections[k]
        seen = [m for m in marks if int(m["k"]) == k and m["visible"] == "1"]
        moved = {"tear", "fold", "duplicate"} & set(row["defects"].split(";"))
        if len(seen) < 3 or moved or row["present"] != "1":
            continue
        used += 1
        fit = rigid([(float(m["x_px"]) * px_um, float(m["y_px"]) * px_um) for m in seen],
                    [columns[m["marker"]] for m in seen], row["flip"] == "1")
        warp = warp_of(options.folder / f"warp_k{k:03}.csv")
        m = [float(row[name]) for name in ("m00", "m01", "m02", "m10", "m11", "m12")]
        for x, y in points(truth, float(row["z_um"])):
            n = (0.0, 0.0)
            for _ in range(12):
                px = m[0] * (x - n[0]) + m[1] * (y - n[1]) + m[2]
                py = m[3] * (x - n[0]) + m[4] * (y - n[1]) + m[5]
                n = warp(px, py)
            u, v = fit(px * px_um, py * px_um)
            squares += (u - x) ** 2 + (v - y) ** 2
            count += 1
    if not count:
        print("no section of the region shows all its marks")
        return 1
    rms = math.sqrt(squares / count)
    print(f"{used} sections: {rms:.2f} um")
    return 0 if options.between[0] <= rms <= options.between[1] else 1


if __name__ == "__main__":
    sys.exit(main())
