#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Makes tiles.bin, the two texture tiles of the phantom, from a picrosirius photograph.

    make_tiles.py psr_left.jpg tiles.bin

Needs python3-pil and python3-numpy; the build does not run it. tiles.bin holds T1 (red, 180 x 170
texels) and then T2 (yellow, 300 x 430), one signed byte per texel, row by row, 40 steps to one
standard deviation.
"""

import hashlib
import sys

import numpy as np
from PIL import Image

WHITE = np.array([255.0, 245.0, 234.0])
RED = np.array([0.239, 0.716, 0.655])
YELLOW = np.array([0.357, 0.326, 0.875])
BOX = 48
STEPS = 40


def box_mean(plane):
    """Mean over BOX x BOX pixels, the picture mirrored at its border."""
    before, after = BOX // 2, BOX - BOX // 2 - 1
    for axis in (0, 1):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (before + 1, after)
        total = np.cumsum(np.pad(plane, pad, mode="symmetric"), axis=axis)
        count = plane.shape[axis]
        upper = np.take(total, range(BOX, BOX + count), axis=axis)
        plane = (upper - np.take(total, range(count), axis=axis)) / BOX
    return plane


def tile(plane, x0, x1, y0, y1):
    part = plane[y0:y1 + 1, x0:x1 + 1]
    half = part.reshape(part.shape[0] // 2, 2, part.shape[1] // 2, 2).mean(axis=(1, 3))
    wave = np.clip(half / box_mean(half) - 1.0, -0.9, 1.5)
    print(f"{half.shape[1]} x {half.shape[0]}: standard deviation {wave.std():.3f}, "
          f"mean {wave.mean():.4f}")
    return np.rint(wave / wave.std() * STEPS).astype(np.int8)


def main():
    source, target = sys.argv[1:3]
    pixels = np.asarray(Image.open(source).convert("RGB"), dtype=float)
    density = -np.log10(np.maximum(pixels, 1.0) / WHITE)
    dyes = np.stack([v / np.linalg.norm(v) for v in (RED, YELLOW)], axis=1)
    amount = np.maximum(density @ np.linalg.pinv(dyes).T, 0.0)
    t1 = tile(amount[:, :, 0], 560, 919, 420, 759)
    t2 = tile(amount[:, :, 1], 420, 1019, 1150, 2009)
    with open(target, "wb") as out:
        out.write(t1.tobytes() + t2.tobytes())
    with open(source, "rb") as image:
        print("sha256 of the source:", hashlib.sha256(image.read()).hexdigest())


main()
