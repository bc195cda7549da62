#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The pictures of docs/user/gallery.md, made again by the commands that stand below them.

    gallery.py BIN [--write]     BIN: the programs' folder; --write: the pictures are replaced

Each picture of the page has to be what its command gives: of the same size, and on the mean no
farther from it than MEAN of 255. The tooth is of the developers' ../shared: its pictures are left out
where that is missing, and said so; phantoms are drawn. Needs pngtopnm (Debian: netpbm). Exit 77:
nothing could be compared."""
import argparse
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile

SKIPPED = 77
ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "user" / "gallery.md"
TOOTH = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared")) / "data" / "volumes" / "tooth.mhd"
SHAPE, EVERY = (140, 120, 161), 4
# What other rounding of another processor or font engine may change; another view changes some 10.
MEAN = 0.5


class Bench:
    """Specimens by the store that they are in, each made when a picture first asks for it."""

    def __init__(self, programs, folder):
        self.programs, self.folder, self.there = programs, folder, set()

    def gieson(self, *args):
        done = subprocess.run([str(self.programs / "gieson"), *map(str, args)], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True)
        if done.returncode:
            raise SystemExit(f"gieson {' '.join(map(str, args))}: {done.stdout}")

    def volume(self, store, name, header):
        self.gieson("--store", store, "import", "--volume", header, "--spacing-unit", "um", "--threshold",
                    "100", "--specimen", name)

    def make_teeth(self, store):
        self.volume(store, "tooth", TOOTH)
        voxels = TOOTH.with_suffix(".raw").read_bytes()
        nx, ny, nz = SHAPE
        picked = bytes(voxels[x + nx * (y + ny * z)] for z in range(0, nz, EVERY) for y in range(0, ny, EVERY)
                       for x in range(0, nx, EVERY))
        size = " ".join(str(-(-n // EVERY)) for n in SHAPE)
        (self.folder / "coarse.raw").write_bytes(picked)
        (self.folder / "coarse.mhd").write_text(
            f"NDims = 3\nDimSize = {size}\nElementType = MET_UCHAR\nElementSpacing = {EVERY} {EVERY} {EVERY}\n"
            "ElementByteOrderMSB = False\nElementDataFile = coarse.raw\n")
        self.volume(store, "tooth-coarse", self.folder / "coarse.mhd")

    def make_stages(self, store):
        for name in ("S00", "S01", "S02"):
            self.gieson("phantom", "--level", "L0", "--px", "24", "--specimen", name, "--out",
                        self.folder / name)
            self.gieson("--store", store, "import", self.folder / name)

    def store_of(self, kind):
        store = self.folder / kind
        if kind not in self.there:
            self.there.add(kind)
            if kind == "colour":
                self.gieson("demo", self.folder / "demo")
                (self.folder / "demo" / "store").rename(store)
            else:
                {"teeth": self.make_teeth, "stages": self.make_stages}[kind](store)
                self.gieson("--store", store, "run")
        return store


def kind_of(figure):
    return {"gallery-stages": "stages", "gallery-colour": "colour"}.get(figure, "teeth")


def pixels(path):
    """(width and height, bytes)"""
    done = subprocess.run(["pngtopnm", str(path)], stdout=subprocess.PIPE, check=True).stdout
    head = re.match(rb"P6\s+(\d+)\s+(\d+)\s+255\s", done)
    return (int(head[1]), int(head[2])), done[head.end():]


def figures():
    """(figure, its command) in the order of the page."""
    text = PAGE.read_text(encoding="utf-8")
    for found in re.finditer(r"!\[[^\]]*\]\(figures/([\w-]+)\.png\)\s*`(gieson render [^`]*)`", text):
        yield found[1], shlex.split(found[2])[1:]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    wrong = compared = 0
    if not shutil.which("pngtopnm"):
        print("pngtopnm is not there (Debian: netpbm): no picture is compared")
        return SKIPPED
    with tempfile.TemporaryDirectory(prefix="gieson-gallery-") as folder:
        bench = Bench(asked.bin.resolve(), pathlib.Path(folder))
        for figure, command in figures():
            if kind_of(figure) == "teeth" and not TOOTH.exists():
                print(f"{figure}: {TOOTH} is not there, so it is not compared")
                continue
            made, kept = bench.folder / f"{figure}.png", PAGE.parent / "figures" / f"{figure}.png"
            bench.gieson("--store", bench.store_of(kind_of(figure)),
                         *(made if part.endswith(".png") else part for part in command))
            if asked.write:
                shutil.copyfile(made, kept)
            (size, ours), (asked_size, theirs) = pixels(made), pixels(kept)
            off = sum(abs(a - b) for a, b in zip(ours, theirs)) / len(theirs)
            fine = size == asked_size and off <= MEAN
            print(f"{figure}: {size[0]} x {size[1]}, {off:.3f} of 255 from the page's" +
                  ("" if fine else f" ({asked_size[0]} x {asked_size[1]}): gallery.py --write, and look at it"))
            compared += 1
            wrong += not fine
    return 1 if wrong else 0 if compared else SKIPPED


if __name__ == "__main__":
    sys.exit(main())
