#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""A region that is drawn gives the loss of the mask that it was drawn after.

    drawn_region.py BIN

A spindle in a volume whose loss rises from left to right is stated as a mask, as outlines of all its
planes, and as outlines of the first, the middle and the last plane, between which it is interpolated.
"""
import json
import math
import os
import pathlib
import struct
import subprocess
import sys
import tempfile

NX, NY, NZ, STEP, INTERVAL = 32, 24, 7, 5, 24
ORIGIN = (-35, 60, 12)
FIRST, MIDDLE, LAST = 1, 3, 5  # planes of the spindle
SENTENCE = "drawn on 3 of 7 planes, from z 36 to 132 um; interpolated on the 2 between"


def check(claim, sentence):
    if not claim:
        raise SystemExit(f"not true: {sentence}")


def radius(z):
    return 10.4 - 1.8 * abs(z - MIDDLE) if FIRST <= z <= LAST else 0


def holds(x, y, z):
    return math.hypot(x + 0.5 - 18, y + 0.5 - 12.2) < radius(z)


def write_volume(path, kind, value):
    cells = [value(x, y, z) for z in range(NZ) for y in range(NY) for x in range(NX)]
    path.write_bytes(
        f"ObjectType = Image\nNDims = 3\nDimSize = {NX} {NY} {NZ}\nElementSpacing = {STEP} {STEP} {INTERVAL}\n"
        f"Offset = {ORIGIN[0]} {ORIGIN[1]} {ORIGIN[2]}\nElementType = {'MET_FLOAT' if kind == 'f' else 'MET_UCHAR'}\n"
        "ElementDataFile = LOCAL\n".encode() + struct.pack(f"<{len(cells)}{kind}", *cells))


def steps(z):
    """The outline of a plane's pixels: down their left sides, up their right ones."""
    rows = [(y, [x for x in range(NX) if holds(x, y, z)]) for y in range(NY)]
    rows = [(y, xs) for y, xs in rows if xs]
    left = [p for y, xs in rows for p in ([xs[0], y], [xs[0], y + 1])]
    right = [p for y, xs in reversed(rows) for p in ([xs[-1] + 1, y + 1], [xs[-1] + 1, y])]
    return [*left, *right, left[0]]


def circle(z):
    turns = [2 * math.pi * (i % 90) / 90 for i in range(91)]
    return [[round(18 + radius(z) * math.cos(t), 2), round(12.2 + radius(z) * math.sin(t), 2)] for t in turns]


def collection(outlines):
    return {"type": "FeatureCollection", "features": [
        {"type": "Feature", "id": f"00000000-0000-0000-0000-{z:012}", "geometry": {
            "type": "Polygon", "plane": {"c": -1, "z": z, "t": 0}, "coordinates": [ring]},
         "properties": {"objectType": "annotation", "classification": {"name": "PDL", "color": [200, 0, 0]}}}
        for z, ring in outlines.items()]}


def main():
    gieson = str(pathlib.Path(sys.argv[1]) / "gieson")
    stack = {"size": [NX, NY, NZ], "pixel_um": [STEP, STEP, INTERVAL], "origin_um": ORIGIN}
    with tempfile.TemporaryDirectory(prefix="gieson-drawn-") as place:
        folder = pathlib.Path(place)
        env = dict(os.environ, GIESON_STORE=str(folder / "store"))

        def run(*words):
            done = subprocess.run([gieson, *map(str, words)], env=env, capture_output=True, text=True)
            check(done.returncode == 0, f"gieson {words} ends well: {done.stdout}{done.stderr}")
            return done.stdout + done.stderr

        for name, lost in (("control", 0), ("treated", 0.5)):
            home = folder / name
            home.mkdir()
            write_volume(home / "v.mhd", "f", lambda x, y, z: 0.8 * (1 - lost * x / NX))
            write_volume(home / "mask.mhd", "B", lambda x, y, z: int(holds(x, y, z)))
            for file, outlines in (("all", {z: steps(z) for z in range(FIRST, LAST + 1)}),
                                   ("some", {z: circle(z) for z in (FIRST, MIDDLE, LAST)})):
                (home / f"{file}.geojson").write_text(json.dumps(collection(outlines)))
            job = {"specimen": name, "kind": "volume", "file": "v.mhd", "spacing_unit": "um",
                   "region": "mask.mhd",
                   "regions": {file: {"kind": "drawn", "file": f"{file}.geojson", "class": "PDL", "stack": stack}
                               for file in ("all", "some")}}
            if lost:
                job["baseline"] = "control"
            (home / "job.json").write_text(json.dumps(job))
            check(SENTENCE in run("import", home), "the import says where it was drawn")
        run("run")
        report = json.loads(run("report", "treated", "--json"))
        mask, drawn = report, {r["name"]: r for r in report["regions"]}
        print(mask["loss_percent"], {name: (r["loss_percent"], r["volume_mm3"]) for name, r in drawn.items()})
        check(25 < mask["loss_percent"] < 32, f"the mask's loss is {mask['loss_percent']}")
        check(abs(drawn["all"]["loss_percent"] - mask["loss_percent"]) <= 0.05, "all planes: the mask's loss")
        check(drawn["all"]["volume_mm3"] == mask["region"]["volume_mm3"], "and its volume, to the voxel")
        check(abs(drawn["some"]["loss_percent"] - mask["loss_percent"]) <= 0.05, "three planes: the mask's loss")
        check(abs(drawn["some"]["volume_mm3"] / mask["region"]["volume_mm3"] - 1) < 0.03, "and its volume")
        check(drawn["some"]["description"] == "drawn as PDL", "the rule has the classification")
        inner = folder / "store" / "reports" / "treated" / "latest" / "region-some.html"
        check(SENTENCE in inner.read_text(), "its page says where it was drawn")
        run("verify", "treated")
    return 0


if __name__ == "__main__":
    sys.exit(main())
