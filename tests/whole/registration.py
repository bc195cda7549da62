#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Marks and poses of one phantom specimen against its truth.

    registration.py REPORT.json TRUTH_DIR [--level L2] [--refined] [--verbose]

REPORT.json is what `gieson report SPECIMEN --json` prints. A mark is found when the place given for
its number is within 25 um (a third of a burn's radius) of where it is seen. The error of a section
is the distance, over the region of interest and root mean square, between where its pose puts the
material and where that lies (size and warp n(p) included); the floor is the same with the best rigid
motion of the true marks; --refined: the job asked for more than rigid poses, and the limit is
that of such. Sections that are torn or folded have no one such error and are left out of
it. Exit status 1 when the level's demands are not met.
"""
import argparse
import json
import math
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "phantom"))
from registration_floor import SECTIONS, points, rigid, rows_of, warp_of  # noqa: E402

FOUND_UM = 25.0
# level -> share of visible marks found, error over floor, share of clean sections flagged
DEMANDED = {"L0": (1.0, 2.0, 0.0), "L1": (1.0, 4.0, 0.0),
            "L2": (0.99, 1.2, 0.02), "L3": (0.95, 1.2, 0.10)}
# Where strain or tissue was used: um, whatever rigid poses could do.
REFINED = {"L2": 10.0}
# At L0 and L1 the floor is nothing: the limit is in um.
ABSOLUTE = {"L0", "L1"}
# Where a flip or a half turn may be wrong in a section that is flagged doubtful.
EXACT_OR_FLAGGED = {"L3"}


class Truth:
    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self.data = json.loads((self.folder / "truth.json").read_text(encoding="utf-8"))
        self.column = {int(m["marker"]): m["block_um"] for m in self.data["markers"]}
        self.section = {int(r["k"]): r for r in rows_of(self.folder / "sections.csv")}
        self.mark = {k: {} for k in self.section}
        files = self.folder / "files.csv"
        # What no file shows whole, nobody can find.
        shown = {r["panel"] for r in rows_of(files) if float(r["kept"]) == 1} \
            if files.is_file() else {r["panel"] for r in self.section.values()}
        self.delivered = {k for k, r in self.section.items() if r["panel"] in shown}
        for row in rows_of(self.folder / "markers.csv"):
            self.mark[int(row["k"])][int(row["marker"])] = (
                float(row["x_px"]), float(row["y_px"]), row["visible"] == "1", row["occluded_by"])

    def px_um(self, k):
        return float(self.section[k]["px_um"])

    def present(self, k):
        return self.section[k]["present"] == "1"

    def defects(self, k):
        return [d for d in self.section[k]["defects"].split(";") if d]

    def visible(self, k):
        return {i: m for i, m in self.mark[k].items() if m[2]} if self.present(k) else {}

    def clean(self, k):
        return self.present(k) and not self.defects(k) and len(self.visible(k)) == 3

    def whole(self, k):
        return self.present(k) and not {"tear", "fold"} & set(self.defects(k))

    def places(self, k):
        """Points of the region in this section, and the panel pixels that show them."""
        row, path = self.section[k], self.folder / f"warp_k{k:03}.csv"
        warp = warp_of(path) if path.is_file() else lambda px, py: (0.0, 0.0)
        m = [float(row[name]) for name in ("m00", "m01", "m02", "m10", "m11", "m12")]
        for x, y in points(self.data, float(row["z_um"]), 120):
            n = (0.0, 0.0)
            for _ in range(6):
                px = m[0] * (x - n[0]) + m[1] * (y - n[1]) + m[2]
                py = m[3] * (x - n[0]) + m[4] * (y - n[1]) + m[5]
                n = warp(px, py)
            yield x, y, px, py

    def floor_map(self, k):
        """What the exact visible marks allow, or None for fewer than two."""
        marks, scale = self.visible(k), self.px_um(k)
        if len(marks) < 2:
            return None
        fit = rigid([(m[0] * scale, m[1] * scale) for m in marks.values()],
                    [self.column[i] for i in marks], self.section[k]["flip"] == "1")
        return lambda px, py: fit(px * scale, py * scale)


def pose_map(section):
    m = section["panel_to_block_um"]
    return m and (lambda px, py: (m[0] * px + m[1] * py + m[2], m[3] * px + m[4] * py + m[5]))


def rms_of(place, where):
    squares = [(u - x) ** 2 + (v - y) ** 2 for x, y, px, py in place for u, v in [where(px, py)]]
    return math.sqrt(sum(squares) / len(squares))


def pooled(values):
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else 0.0


def judge_marks(truth, k, section, out):
    """Counts one section's marks into out; returns what is wrong, in words."""
    wrong, scale = [], truth.px_um(k)
    visible = truth.visible(k)
    out["visible"] += len(visible)
    for number in (1, 2, 3):
        given = section["markers_px"][number - 1]
        given = None if not given or given[0] is None else given
        off = {i: scale * math.hypot(given[0] - m[0], given[1] - m[1])
               for i, m in truth.mark[k].items()} if given else {}
        if number in visible and given and off[number] <= FOUND_UM:
            out["found"] += 1
            out["off_um"].append(off[number])
        elif number in visible and not given:
            wrong.append(f"mark {number} not found")
        elif given and truth.present(k) and off[number] > FOUND_UM:
            near = min(off, key=off.get)
            kind = "misnumbered" if off[near] <= FOUND_UM else "false"
            accepted = section["state"] == "used"
            out[kind] += 1
            out["accepted"] += accepted
            wrong.append(f"mark {number} {kind} ({off[number]:.0f} um off"
                         f"{', accepted' if accepted else ''})")
    return wrong


def judge_way(truth, k, section, level):
    """Flip and half turn, where the section has a pose that is used."""
    row = truth.section[k]
    if not truth.present(k) or not section["panel_to_block_um"] or section["state"] == "held" or \
            (section["state"] == "doubtful" and level in EXACT_OR_FLAGGED):
        return []
    theta = (float(row["theta_deg"]) + 180) % 360 - 180
    wrong = [] if section["flipped"] == (row["flip"] == "1") else ["flip wrong"]
    # Turned by very nearly a right angle, either answer will do.
    if abs(abs(theta) - 90) > 3 and section["rotated180"] != (abs(theta) > 90):
        wrong.append("half turn wrong")
    return wrong


def judge_place(truth, k, section):
    """A slot without a section must not carry one silently: it is held or doubtful, or named as
    the same section as another."""
    if truth.present(k):
        return [] if section["state"] != "missing" else ["called missing"]
    named = any(flag.startswith("same-as-") for flag in section["flags"])
    return [f"not there ({'; '.join(truth.defects(k))}), yet {section['state']}"] \
        if section["state"] == "used" and not named else []


def judge(report, truth, level, verbose=False, say=print, sound_only=False, refined=False):
    sections = {s["serial"]: s for s in report["sections"] if s["serial"] is not None}
    out = {"visible": 0, "found": 0, "false": 0, "misnumbered": 0, "accepted": 0, "off_um": [],
           "way": 0, "place": 0, "clean": 0, "flagged": 0, "silent": 0,
           "error": [], "floor": [], "doubtful": [], "doubtful_floor": []}
    for k in sorted(truth.delivered):
        section = sections.get(k) or {
            "state": "absent", "flags": [], "markers_px": [None] * 3, "flipped": False,
            "rotated180": False, "panel_to_block_um": None}
        lines = judge_marks(truth, k, section, out)
        way, place = judge_way(truth, k, section, level), judge_place(truth, k, section)
        out["way"] += len(way)
        out["place"] += len(place)
        flagged = section["state"] != "used"
        if truth.clean(k):
            out["clean"] += 1
            out["flagged"] += flagged
            lines += ["clean, yet " + section["state"]] if flagged else []
        where, best = pose_map(section), truth.floor_map(k)
        if k in SECTIONS and truth.whole(k) and where and best:
            at = list(truth.places(k))
            error, floor = rms_of(at, where), rms_of(at, best)
            three = len(truth.visible(k)) == 3
            good = not flagged and three
            out["error" if good else "doubtful"].append(error)
            out["floor" if good else "doubtful_floor"].append(floor)
            if error > 2 * floor + 8:
                lines.append(f"error {error:.0f} um, floor {floor:.0f} um")
                out["silent"] += not flagged
        if (lines or way or place) and verbose:
            say(f"  section {k + 1} ({section['state']}; {' '.join(section['flags'])}; truth "
                f"{' '.join(truth.defects(k)) or 'clean'}): {'; '.join(lines + way + place)}")
    return verdict(out, level, say, sound_only, refined)


def verdict(out, level, say, sound_only=False, refined=False):
    """Whether the level's demands are met; sound_only: whether nothing that is used is wrong, however
    much was found."""
    share, ratio, most = DEMANDED[level]
    error, floor = pooled(out["error"]), pooled(out["floor"])
    limit = ratio if level in ABSOLUTE else ratio * floor
    limit = REFINED.get(level, limit) if refined else limit
    sound = (out["accepted"] == 0 and error <= limit and out["way"] == 0 and out["place"] == 0
             and out["silent"] == 0)
    met = (sound and out["found"] >= share * out["visible"]
           and out["flagged"] <= most * out["clean"])
    say(f"marks {out['found']} of {out['visible']} found "
        f"({100 * out['found'] / max(out['visible'], 1):.1f} %), {pooled(out['off_um']):.2f} um off; "
        f"{out['false']} false, {out['misnumbered']} misnumbered, {out['accepted']} of them "
        f"accepted; region {error:.2f} um, floor {floor:.2f}, limit {limit:.2f} over "
        f"{len(out['error'])} sections (doubtful ones {pooled(out['doubtful']):.1f}, floor "
        f"{pooled(out['doubtful_floor']):.1f}, {len(out['doubtful'])}); clean flagged "
        f"{out['flagged']} of {out['clean']}; flips and turns wrong {out['way']}, places "
        f"{out['place']}, silently off {out['silent']}{'' if met else '   NOT MET'}")
    return sound if sound_only else met


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=pathlib.Path)
    parser.add_argument("truth", type=pathlib.Path)
    parser.add_argument("--level", default="L2", choices=sorted(DEMANDED))
    parser.add_argument("--refined", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    args = parser.parse_args()
    report = json.loads(args.report.read_text(encoding="utf-8"))
    return 0 if judge(report, Truth(args.truth), args.level, args.verbose,
                      refined=args.refined) else 1


if __name__ == "__main__":
    sys.exit(main())
