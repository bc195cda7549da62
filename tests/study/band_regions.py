#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Two animals of one anatomy by one rule, from their panels: a band about each one's own root.

    band_regions.py BIN [--seed 27] [--keep DIR]

A control and a treated animal (N1, U1) at level L1 with their calibration panels. Each root is found in
its own stack, 10 to 20 um too wide where the ligament's grain is as dense as dentine, so the regions are
not of one volume; the loss must be that of the true band within a point. The band begins 70 um beyond
the ligament: one that begins at the wall itself, where the density doubles, is 1.1 points off here. The truth is computed anew from truth.json: distances are those from the nearest point of the
root's paraboloid, as far as the block was cut. (The phantom's own region counts by value over slope,
which is less than the distance away from the surface: it is another region.)
"""
import argparse
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "phantom"))
from recompute_loss import Block  # noqa: E402

LOW, HIGH, Z, CENTRE, RADIUS = 250, 630, (120, 720), (411, 646), 900
STEP = 40  # of the true band's midpoints, um
WITHIN = 1.0


def root_point(g, angle, z):
    s = math.sqrt(max(0.0, (z - g["zap"]) / g["Lr"]))
    return (g["cx"] + g["tx"] * z + g["a"] * s * math.cos(angle),
            g["cy"] + g["ty"] * z + g["b"] * s * math.sin(angle), z)


def root_distance(g, at, end):
    """From a point outside of it to the root, which is seen as far as z = end; pattern search."""
    angle = math.atan2(at[1] - g["cy"] - g["ty"] * at[2], at[0] - g["cx"] - g["tx"] * at[2])
    best, angle, z = min((math.dist(at, root_point(g, angle, z)), angle, z)
                         for z in (g["zap"] + (end - g["zap"]) * i / 8 for i in range(9)))
    step_z, step_angle = (end - g["zap"]) / 16, 0.4
    while step_z > 2:
        near = min((math.dist(at, root_point(g, a, h)), a, h)
                   for a in (angle - step_angle, angle, angle + step_angle)
                   for h in (max(g["zap"], z - step_z), z, min(end, z + step_z)))
        if near[0] < best:
            best, angle, z = near
        else:
            step_z, step_angle = step_z / 2, step_angle / 2
    return best


def true_band(g, end):
    """Midpoints of the band."""
    points, across = [], round(2 * RADIUS / STEP)
    for k in range(round((Z[1] - Z[0]) / STEP)):
        for j in range(across):
            for i in range(across):
                at = (CENTRE[0] - RADIUS + (i + 0.5) * STEP, CENTRE[1] - RADIUS + (j + 0.5) * STEP,
                      Z[0] + (k + 0.5) * STEP)
                if math.dist(at[:2], CENTRE) <= RADIUS and \
                        Block({"geometry": g, "lesion": None}).distance(*at) > 0 and \
                        LOW <= root_distance(g, at, end) < HIGH:
                    points.append(at)
    return points


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--seed", type=int, default=27)
    parser.add_argument("--keep", type=pathlib.Path, help="an empty folder for the store")
    args = parser.parse_args()
    failed = 0

    with tempfile.TemporaryDirectory(prefix="gieson-band-") as place:
        folder = args.keep or pathlib.Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        env = dict(os.environ, GIESON_STORE=str(folder / "store"))

        def run(*words):
            return subprocess.run([str(args.bin / "gieson"), *map(str, words)], env=env, check=True,
                                  stdout=subprocess.PIPE, text=True).stdout

        (folder / "calibrated.json").write_text('{"calibration": true}')
        for animal in ("N1", "U1"):
            out = folder / f"GVP-D-{animal}"
            subprocess.run([str(args.bin / "gieson-phantom"), "--specimen", animal, "--level", "L1",
                            "--seed", str(args.seed), "--px", "24", "--variant",
                            str(folder / "calibrated.json"), "--out", str(out)], check=True)
            job = json.loads((out / "job.json").read_text())
            job["region"] = {"kind": "band", "from": "root", "low_um": LOW, "high_um": HIGH, "z": Z,
                             "within": {"centre": CENTRE, "radius": RADIUS}}
            if "baseline" in job:
                job["baseline"] = "GVP-D-N1"
            (out / "job.json").write_text(json.dumps(job))
            run("import", out)
        run("run")

        truth = {a: json.loads((folder / f"GVP-D-{a}" / "truth" / "truth.json").read_text())
                 for a in ("N1", "U1")}
        end = job["sections"] * job["interval_um"]
        points = true_band(truth["N1"]["geometry"], end)
        true_mm3 = len(points) * STEP ** 3 * 1e-9
        left = {a: math.fsum(Block(t).densities(*p)[1] for p in points) for a, t in truth.items()}
        true = 100 * (1 - left["U1"] / left["N1"])
        report = json.loads(run("report", "GVP-D-U1", "--json"))
        control = json.loads(run("report", "GVP-D-N1", "--json"))
        for name, volume in (("control", control["region"]["volume_mm3"]),
                             ("treated", report["region"]["volume_mm3"])):
            print(f"{name}: {volume:.4f} mm3, true {true_mm3:.4f}", flush=True)
        if report["loss_percent"] is None:
            raise SystemExit(f"not compared: {report['loss_reason']}")
        error = report["loss_percent"] - true
        interval = report["loss_interval"]
        print(f"loss {report['loss_percent']:.2f} % ({interval['lower']:.2f} to "
              f"{interval['upper']:.2f}), true {true:.2f}, error {error:+.2f} points")
        if abs(error) > WITHIN:
            print("not true: the loss of the band is within a point of the truth")
            failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
