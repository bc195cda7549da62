#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The OpenCV side of gieson-bench: decoding, splitting and registering a panel, one thread.

    opencv_probe.py SIDE

SIDE is that of a section's square in pixels; its marks have a radius of SIDE / 94. Orders come one
a line on stdin; each is answered with a line, seconds of CPU time and a number:
    read PATH    cv2.imread; the number of rows
    split        of the picture read last: sections found on a reduction to 1/16
    chain PATH   read, split, marks of each section, rigid pose, resampling; sections registered
Ends at the end of stdin; exits at once when OpenCV is not there.
"""
import itertools
import sys
import time

import cv2
import numpy as np


def boxes(picture):
    small = cv2.resize(picture, None, fx=1 / 16, fy=1 / 16, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
    mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1]
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3)))
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_32S)
    return [(stats[i][:4] * 16).tolist() for i in range(1, count) if stats[i][4] > 0.003 * mask.size]


def refined(grey, at, radius):
    """Centroid of the darkness in a window around a spot."""
    reach = int(1.6 * radius) + 2
    x0, y0 = max(int(round(at[0])) - reach, 0), max(int(round(at[1])) - reach, 0)
    window = grey[y0:y0 + 2 * reach + 1, x0:x0 + 2 * reach + 1].astype(np.float32)
    low, high = float(window.min()), float(np.percentile(window, 50))
    window = np.clip(0.5 * (low + high) - window, 0, None)
    total = window.sum()
    if total <= 0:
        return at
    x = np.arange(x0, x0 + window.shape[1], dtype=np.float32)
    y = np.arange(y0, y0 + window.shape[0], dtype=np.float32)
    return float((window.sum(0) * x).sum() / total), float((window.sum(1) * y).sum() / total)


def marks(picture, radius):
    """Dark round spots, looked for at a quarter of the size."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, None, fx=.25, fy=.25, interpolation=cv2.INTER_AREA)
    dark = 0.45 * np.percentile(small[::8, ::8], 50)
    mask = cv2.threshold(small, dark, 255, cv2.THRESH_BINARY_INV)[1]
    count, _, stats, centre = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_32S)
    disc, found = np.pi * (radius / 4) ** 2, []
    for i in range(1, count):
        _, _, w, h, area = stats[i]
        if 0.25 * disc <= area <= 2.2 * disc and max(w, h) <= 1.7 * min(w, h) and area >= 0.6 * w * h:
            found.append(refined(grey, (centre[i][0] * 4 + 1.5, centre[i][1] * 4 + 1.5), radius))
    return found


def pose(found, triangle):
    """The triple whose sides fit the triangle best, and the motion it asks for."""
    sides = [np.linalg.norm(triangle[i] - triangle[j]) for i, j in ((0, 1), (1, 2), (0, 2))]
    best, choice = 6.0, None
    spots = np.array(found, float).reshape(-1, 2)
    for i, j, k in itertools.permutations(range(len(spots)), 3):
        own = [np.linalg.norm(spots[a] - spots[b]) for a, b in ((i, j), (j, k), (i, k))]
        worst = max(abs(a - b) for a, b in zip(own, sides))
        if worst < best:
            best, choice = worst, spots[[i, j, k]]
    if choice is None:
        return None
    turned = np.linalg.det(choice[1:] - choice[0]) * np.linalg.det(triangle[1:] - triangle[0]) < 0
    onto = triangle * (-1, 1) if turned else triangle
    motion = cv2.estimateAffinePartial2D(onto.astype(np.float32), choice.astype(np.float32))[0]
    return motion @ np.diag([-1 if turned else 1, 1, 1])


def register(picture, side):
    triangle = np.array([[-450., -100.], [380., -200.], [150., 330.]]) * side / 1500
    sections = 0
    for x, y, w, h in boxes(picture):
        one = picture[y:y + h, x:x + w]
        motion = pose(marks(one, side / 94), triangle)
        if motion is None:
            continue
        shift = motion[:, 2] - motion[:, :2] @ np.array([side / 2, side / 2])
        cv2.warpAffine(one, np.column_stack([motion[:, :2], shift]), (side, side),
                       flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=(235, 235, 235))
        sections += 1
    return sections


def main():
    side, picture = int(sys.argv[1]), None
    cv2.setNumThreads(1)
    for line in sys.stdin:
        order, _, path = line.strip().partition(" ")
        before, number = time.process_time(), 0
        if order == "read":
            picture = None
            picture = cv2.imread(path)
            number = picture.shape[0]
        elif order == "split":
            number = len(boxes(picture))
        elif order == "chain":
            number = register(cv2.imread(path), side)
        print(repr(time.process_time() - before), number, flush=True)


if __name__ == "__main__":
    main()
