#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The model against splines on a plain grid, on a tooth whose density is known everywhere.

    tooth.py LIBRARY MODULE MESHER [--keep FOLDER]

LIBRARY is libgieson-spline.so, MODULE the folder of gieson_spline.py, MESHER gieson-mesh. The tooth, its
test points (200 000: anywhere, at the wall, inside) and the peer, least squares of a tensor product
B-spline, are those of ../shared/peers: 128^3 voxels of a curved tooth with a canal, its wall blurred by
one voxel, clean and with noise of 0.02. Outside of its mesh our model is 0. Printed are unknowns and rms
errors, and of one model the volumes above thresholds, counted as the density's are, on 384^3 places.

Exit 1: more than the bounds below; 77: ../shared, numpy or scipy is missing."""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

SKIPPED = 77
DEBIANS = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]
PEERS = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared")) / "peers"
sys.path.insert(0, str(PEERS / "gen"))
try:
    import numpy
    import phantom
    import scipy.ndimage
except ImportError:
    if sys.executable != DEBIANS and os.path.exists(DEBIANS):
        os.execv(DEBIANS, [DEBIANS, *sys.argv])
    print(f"SKIPPED: numpy, scipy or {PEERS} is not there")
    sys.exit(SKIPPED)

N = 128
STEP = 2 / N
NOISE = 0.02
FINE = 384
# Voxels around the tissue in which the model is fitted: beyond them the density is 0 to three digits.
AROUND = 4
# degree, edge in voxels; the most unknowns and rms error anywhere.
CLEAN = ((1, 4.05, 4000, 0.004), (2, 8, 16000, 0.0025))
NOISY = (2, 4.5)
# Of the best tensor spline's error: anywhere, inside.
NOISY_MOST = {"box": 0.4, "inside": 0.5}
LEVELS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
VOLUMES = (3, 8.3, 30000)
# Of the volume above the last level, where little is left, and above the others.
OFF_MOST = (0.006, 0.0025)


def generate(folder):
    def run(script, *args):
        subprocess.run([sys.executable, PEERS / "gen" / script, *map(str, args)], check=True,
                       stdout=subprocess.DEVNULL)

    run("gen_volume.py", folder / "clean", "--shape", N)
    run("gen_volume.py", folder / "noisy", "--shape", N, "--noise", NOISE)
    run("gen_points.py", folder / "points.raw", "--grid", N)


def voxels(path):
    return numpy.fromfile(path, "<f4").reshape(N, N, N)


class Tooth:
    """Voxels, which of them are fitted, and the test points."""

    def __init__(self, library, folder, name, mesher):
        self.gs, self.mesher = library, mesher
        self.values = voxels(folder / f"{name}.raw")
        near = scipy.ndimage.gaussian_filter(self.values, 1) > (0.002 if name == "clean" else 0.05)
        pieces, _ = scipy.ndimage.label(near)
        near = pieces == numpy.argmax(numpy.bincount(pieces.ravel())[1:]) + 1
        self.mask = scipy.ndimage.distance_transform_edt(~near) <= AROUND + (name != "clean")
        at = numpy.argwhere(self.mask)
        self.at = (at[:, ::-1] + .5) * STEP - 1
        self.folds = at[:, 0] % 2
        points = numpy.fromfile(folder / "points.raw", "<f8").reshape(-1, 5)
        self.points, self.truth, self.kind = points[:, :3], points[:, 3], points[:, 4]

    def fit(self, degree, edge):
        began = time.process_time()
        space = self.gs.Space.follow(self.values, STEP, edge * STEP, mask=self.mask, origin=STEP / 2 - 1,
                                     degree=degree, cloud=.003, mesher=self.mesher)
        meshed = time.process_time()
        field, report = space.fit(self.at, self.values[self.mask], folds=self.folds, threads=1)
        fitted = time.process_time()
        value = numpy.nan_to_num(field(self.points))
        rms = [float(numpy.sqrt(numpy.mean((value - self.truth)[self.kind == k] ** 2))) for k in range(3)]
        return {"field": field, "unknowns": report.unknowns, "tetrahedra": len(space.tetrahedra),
                "empty": report.empty_tets, "box": rms[0], "wall": rms[1], "inside": rms[2],
                "mesh_s": meshed - began, "fit_s": fitted - meshed}


def say(what, row):
    print(f"{what}: {row['unknowns']} unknowns ({row['tetrahedra']} tetrahedra, {row['empty']} without samples), "
          f"rms {row['box']:.5f} anywhere, {row['wall']:.5f} at the wall, {row['inside']:.5f} inside; "
          f"processor {row['mesh_s']:.1f} s for the mesh, {row['fit_s']:.2f} s for the fit", flush=True)


def tensor(folder, name, widths):
    """The peer's figures by the number of intervals."""
    told = subprocess.run([sys.executable, PEERS / "fit_scipy.py", folder / f"{name}.mhd",
                           folder / "points.raw", "--methods", ",".join(f"lsq:{w}" for w in widths)],
                          check=True, capture_output=True, text=True).stdout
    rows = [json.loads(line) for line in told.splitlines() if line.startswith("{")]
    for row in rows:
        print(f"tensor spline: {row['coefficients']} coefficients, rms {row['rms_box']:.5f} anywhere, "
              f"{row['rms_band']:.5f} at the wall, {row['rms_inside']:.5f} inside; processor "
              f"{row['fit_cpu_s']:.3f} s")
    return rows


def true_volumes():
    """Of the density above each level."""
    tooth = phantom.PHANTOMS["tooth"]()
    fine = phantom.sample(tooth, "density", (FINE, FINE, FINE), STEP)
    return [numpy.count_nonzero(fine > level) * (2 / FINE) ** 3 for level in LEVELS]


def run(args, folder):
    sys.path.insert(0, args.module)
    os.environ["GIESON_SPLINE_LIBRARY"] = args.library
    import gieson_spline

    failed = []
    generate(folder)
    clean = Tooth(gieson_spline, folder, "clean", args.mesher)
    for degree, edge, most, within in CLEAN:
        row = clean.fit(degree, edge)
        say(f"clean, degree {degree}", row)
        if row["unknowns"] > most or row["box"] > within:
            failed.append(f"degree {degree}")
    tensor(folder, "clean", (48, 64))

    noisy = Tooth(gieson_spline, folder, "noisy", args.mesher)
    row = noisy.fit(*NOISY)
    say(f"noise {NOISE}", row)
    peers = tensor(folder, "noisy", (32, 48, 64, 96))
    for what in ("box", "inside"):
        ratio = row[what] / min(peer[f"rms_{what}"] for peer in peers)
        print(f"noise {NOISE}, {what}: {ratio:.2f} of the best tensor spline's error")
        if ratio > NOISY_MOST[what]:
            failed.append(f"noise, {what}")

    row = clean.fit(*VOLUMES[:2])
    say("volumes", row)
    if row["unknowns"] > VOLUMES[2]:
        failed.append("unknowns of the model for volumes")
    grid = numpy.nan_to_num(row["field"].on_grid((FINE, FINE, FINE), 2 / FINE, origin=1 / FINE - 1))
    for level, truth in zip(LEVELS, true_volumes()):
        off = numpy.count_nonzero(grid > level) * (2 / FINE) ** 3 / truth - 1
        print(f"volume above {level}: {100 * off:+.2f} % of {truth:.5f}")
        if abs(off) > OFF_MOST[level < LEVELS[-1]]:
            failed.append(f"volume above {level}")
    for what in failed:
        print(f"TOO FAR OFF: {what}")
    return 1 if failed else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library")
    parser.add_argument("module")
    parser.add_argument("mesher")
    parser.add_argument("--keep", type=pathlib.Path)
    args = parser.parse_args()
    if args.keep:
        args.keep.mkdir(parents=True, exist_ok=True)
        return run(args, args.keep)
    with tempfile.TemporaryDirectory() as folder:
        return run(args, pathlib.Path(folder))


if __name__ == "__main__":
    sys.exit(main())
