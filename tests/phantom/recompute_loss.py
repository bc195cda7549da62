#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Computes the loss of a phantom a second time, from truth/truth.json alone.

    recompute_loss.py TRUTH_DIR [--step UM] [--within POINTS]

Prints loss, region volume and mean density by midpoint sums (plain Python: a step of 24 um takes
seconds, one of 6 um minutes) and compares the loss with loss.csv; exit status 1 if they differ by
more than --within points. Shares nothing with the program that made the phantom but the file.
"""
import argparse
import csv
import json
import math
import pathlib
import sys


def smooth(t):
    u = min(max((t + 1) / 2, 0.0), 1.0)
    return u * u * (3 - 2 * u)


class Block:
    def __init__(self, truth):
        self.g = truth["geometry"]
        self.lesion = truth["lesion"]
        self.bone_gain = truth.get("bone_gain", 1)
        self.floor = truth.get("floor", 0)

    def axis(self, z):
        g = self.g
        return g["cx"] + g["tx"] * z, g["cy"] + g["ty"] * z

    def distance(self, x, y, z, scale=1.0, start=0.0):
        g = self.g
        ox, oy = self.axis(z)
        a, b = g["a"] * scale, g["b"] * scale
        dx, dy = x - ox, y - oy
        value = (dx / a) ** 2 + (dy / b) ** 2 - ((z - g["zap"]) / g["Lr"] - start)
        gx, gy = 2 * dx / a**2, 2 * dy / b**2
        gz = -1 / g["Lr"] - gx * g["tx"] - gy * g["ty"]
        return value / math.sqrt(gx * gx + gy * gy + gz * gz)

    def tissue(self, x, y, z):
        g = self.g
        phi = math.atan2(y / g["Ay"], x / g["Ax"])
        rho = ((abs(x) / g["Ax"]) ** g["p"] + (abs(y) / g["Ay"]) ** g["p"]) ** (1 / g["p"])
        rho /= 1 + sum(a * math.cos(m * phi + p + w * z) for m, a, p, w in g["outline"])
        return smooth((1 - rho) * min(g["Ax"], g["Ay"]) / g["delta"])

    def marrow(self, x, y, z):
        most = 0.0
        for cx, cy, cz, rx, ry, rz in self.g["marrow"]:
            q = math.sqrt(((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2 + ((z - cz) / rz) ** 2)
            most = max(most, smooth((1 - q) * min(rx, ry, rz) / self.g["delta"]))
        return most

    def eaten(self, x, y, z):
        """E, how much of the lesion is here."""
        at, s, phi = self.lesion["centre"], self.lesion["s"], self.lesion["lphi"]
        dx, dy = x - at[0], y - at[1]
        u = math.cos(phi) * dx + math.sin(phi) * dy
        w = math.cos(phi) * dy - math.sin(phi) * dx
        return math.exp(-((u / s[0]) ** 2 + (w / s[1]) ** 2 + ((z - at[2]) / s[2]) ** 2) / 2)

    def densities(self, x, y, z):
        """D without and with the lesion."""
        g = self.g
        delta = g["delta"]
        d = self.distance(x, y, z)
        ox, oy = self.axis(z)
        root = smooth(-d / delta)
        pulp = smooth(-self.distance(x, y, z, g["pulp_scale"], g["pulp_start"]) / delta) * root
        beyond = smooth((d - g["wpdl"]) / delta)
        pdl = (1 - root) * (1 - beyond)
        width = g["wb0"] * (1 + g["wb1"] * math.cos(math.atan2(y - oy, x - ox) - g["wbt"]))
        outer = smooth((d - g["wpdl"] - width) / delta)
        marrow = beyond * (1 - outer) * self.marrow(x, y, z)
        bone = beyond * (1 - outer) - marrow
        plain = bone
        bone *= 1 + g["lam"] * math.cos(2 * math.pi * d / g["lamL"])
        bone *= 1 - g["gz"] * z / g["H"]
        taken = self.lesion["A"] * self.eaten(x, y, z)
        k = g["D"]
        rest = k["conn"] * beyond * outer + k["dent"] * (root - pulp) + k["pulp"] * pulp
        rest += k["marr"] * marrow
        tissue = self.tissue(x, y, z)
        whole = rest + k["pdl"] * pdl + k["bone"] * bone
        in_pdl = self.lesion["in_pdl"] * taken
        left = rest + (k["pdl"] * (1 - in_pdl) + self.floor * in_pdl) * pdl
        left += k["bone"] * bone * self.bone_gain * (1 - taken) + self.floor * plain * taken
        return tissue * whole, tissue * left

    def region(self, step):
        """Midpoints within the region of interest."""
        at, region = self.lesion["centre"], self.g["region"]
        across = round(2 * region["radius"] / step)
        for k in range(round(2 * region["half_height"] / step)):
            z = at[2] - region["half_height"] + (k + 0.5) * step
            for j in range(across):
                y = at[1] - region["radius"] + (j + 0.5) * step
                for i in range(across):
                    x = at[0] - region["radius"] + (i + 0.5) * step
                    if math.hypot(x - at[0], y - at[1]) > region["radius"]:
                        continue
                    d = self.distance(x, y, z)
                    if self.g["wpdl"] <= d < self.g["wpdl"] + region["depth"]:
                        yield x, y, z


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=pathlib.Path)
    options.add_argument("--step", type=float, default=24)
    options.add_argument("--within", type=float, default=0.05)
    options = options.parse_args()

    with open(options.folder / "truth.json", encoding="utf-8") as file:
        block = Block(json.load(file))
    with open(options.folder / "loss.csv", encoding="utf-8", newline="") as file:
        written = next(csv.DictReader(file))

    whole, left = [], []
    for point in block.region(options.step):
        before, after = block.densities(*point)
        whole.append(before)
        left.append(after)
    loss = 100 * (1 - math.fsum(left) / math.fsum(whole))
    volume = len(whole) * options.step**3 * 1e-9
    print(f"loss {loss:.3f} % (loss.csv: {written['loss_pct']}), region {volume:.4f} mm3 "
          f"({written['volume_mm3']}), mean {math.fsum(left) / len(left):.4f} "
          f"({written['mean_D']})")
    apart = abs(loss - float(written["loss_pct"]))
    if not apart <= options.within:
        print(f"the losses are {apart:.3f} points apart, more than {options.within}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
