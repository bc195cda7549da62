#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Sections that nobody here drew and that carry no marks (../shared/data/stacks), laid by tissue.

    real_stacks.py BIN landmarks   five stains of a lung: the error at 80 landmarks a section, beside
                                   SIFT with RANSAC and ECC (../shared/peers/register_tissue.py) and
                                   the best rigid motion of the landmarks themselves, in one run
    real_stacks.py BIN moved       cryosections of a head, each moved by a known motion: true errors
                                   beside the printed ones
    real_stacks.py BIN panels      the same sections and the lung's as panels, from a folder to a
                                   report by tissue: poses against the known places and landmarks

BIN is the programs' folder. A picture's optical density is painted in red and yellow dye on glass, as
a panel of this stain would show it; texture, outlines and what neighbours share stay what they are.
Exit 0: all that was demanded holds; 77: material or python3-opencv is missing."""
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile

SKIPPED = 77
DEBIANS = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]
SHARED = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared"))
STACKS = SHARED / "data" / "stacks"
try:
    import cv2
    import numpy
except ImportError:
    if sys.executable != DEBIANS and os.path.exists(DEBIANS):
        os.execv(DEBIANS, [DEBIANS, *sys.argv])
    print("python3-opencv is not there")
    sys.exit(SKIPPED)

PX_UM = 24.0
ROWS, COLUMNS = 3, 4
# Full red, yellow of empty ground, and the vectors as gieson has them built in (PHANTOM.md).
RED, YELLOW = 0.62, 0.34
VECTORS = [numpy.array(v) / numpy.linalg.norm(v) for v in ((.239, .716, .655), (.357, .326, .875))]
WHITE = numpy.array((248.0, 244.0, 238.0))


def gieson(programs, *args, store=None):
    command = [programs / "gieson", *(["--store", store] if store else []), *args]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode not in (0, 65):
        raise SystemExit(f"{' '.join(map(str, command))}\nended with {done.returncode}\n"
                         f"{done.stdout}{done.stderr}")
    return done.stdout


def matrix(rows):
    return numpy.vstack([numpy.asarray(rows, float)[:2], [0, 0, 1]])


def motion(angle, mirrored, about, onto):
    """Turned by angle about one point and shifted onto another, mirrored in x before."""
    c, s, m = math.cos(angle), math.sin(angle), -1 if mirrored else 1
    turn = numpy.array([[m * c, -s], [m * s, c]])
    return matrix(numpy.column_stack([turn, numpy.asarray(onto) - turn @ numpy.asarray(about)]))


def rms(errors):
    return math.sqrt(sum(e * e for e in errors) / len(errors))


# ---- landmarks ---------------------------------------------------------------------------------

def lung():
    folder = STACKS / "lung-lesion3"
    pictures = sorted(folder.glob("*.jpg"))
    marks = [numpy.loadtxt(folder / "landmarks-50pc-user-PS" / (p.stem + ".csv"), delimiter=",",
                           skiprows=1)[:, 1:] * 0.1 for p in pictures]
    return pictures, marks


def at_marks(way, a, b):
    """Landmarks of one section, laid on another, beside that one's own."""
    return numpy.hypot(*((a @ way[:2, :2].T + way[:2, 2]) - b).T)


def best_rigid(a, b):
    u, _, v = numpy.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = (u @ v).T
    return matrix(numpy.column_stack([turn, b.mean(0) - turn @ a.mean(0)]))


def landmarks(programs):
    sys.path.insert(0, str(SHARED / "peers"))
    import register_tissue as peer
    pictures, marks = lung()
    laid = json.loads(gieson(programs, "--json", "register", STACKS / "lung-lesion3", "--by-tissue"))
    grey = [peer.clahe(cv2.imread(str(p), 0)) for p in pictures]
    rows = {"gieson": [], "SIFT + RANSAC": [], "SIFT + RANSAC + ECC": [], "best rigid": []}
    failed = 0
    for i in range(len(pictures)):
        for k in range(i):
            ours = matrix(laid[pictures[i].name]) @ numpy.linalg.inv(matrix(laid[pictures[k].name]))
            sift, _ = peer.sift_pair(grey[k], grey[i])
            failed += sift is None
            sift = numpy.eye(3) if sift is None else sift
            for name, way in (("gieson", ours), ("SIFT + RANSAC", sift),
                              ("SIFT + RANSAC + ECC", peer.ecc_ref(grey[k], grey[i], sift)),
                              ("best rigid", best_rigid(marks[k], marks[i]))):
                off = at_marks(way, marks[k], marks[i])
                rows[name].append((rms(off), float(numpy.median(off))))
    print(f"landmarks of {len(rows['gieson'])} pairs, px; SIFT found nothing for {failed}")
    for name, pairs in rows.items():
        print(f"  {name:20s} rms {sum(p[0] for p in pairs) / len(pairs):6.2f}  median "
              f"{sum(p[1] for p in pairs) / len(pairs):6.2f}  worst pair {max(pairs)[0]:7.2f}")
    mean = {name: sum(p[0] for p in pairs) / len(pairs) for name, pairs in rows.items()}
    return mean["gieson"] <= 1.1 * mean["best rigid"] and \
        mean["gieson"] <= min(mean["SIFT + RANSAC"], mean["SIFT + RANSAC + ECC"])


# ---- known motions -----------------------------------------------------------------------------

def head(first, last):
    files = sorted((STACKS / "visible-human-axial").glob("*.jpg"))[first:last]
    return [cv2.imread(str(f)) for f in files]


def grid_of(shape):
    """Points all over the middle of a picture."""
    h, w = shape[:2]
    return numpy.array([(w * (.5 + .3 * u), h * (.5 + .3 * v), 1)
                        for u in (-1, 0, 1) for v in (-1, 0, 1)]).T


def moved(programs):
    chance = numpy.random.default_rng(1)
    pictures = head(14, 46)
    with tempfile.TemporaryDirectory() as folder:
        ways = []
        for k, picture in enumerate(pictures):
            h, w = picture.shape[:2]
            side = int(math.hypot(h, w)) + 20
            ways.append(motion(chance.uniform(0, 2 * math.pi), chance.random() < .25,
                               ((w - 1) / 2, (h - 1) / 2),
                               side / 2 + chance.uniform(-6, 6, 2)))
            cv2.imwrite(f"{folder}/{k:03d}.png",
                        cv2.warpAffine(picture, ways[k][:2], (side, side), flags=cv2.INTER_CUBIC,
                                       borderValue=numpy.median(picture[:4], axis=(0, 1)).tolist()))
        laid = json.loads(gieson(programs, "--json", "register", folder, "--by-tissue"))
    rows = list(laid["gieson"]["section"].items())
    points = grid_of(pictures[0].shape)
    frame = laid["gieson"]["frame"]
    there = {name: numpy.linalg.inv(matrix(laid[name])) @ ways[i] @ points
             for i, (name, row) in enumerate(rows) if row["state"] == "by-tissue"}
    sure = [n for n, row in rows if n in there and "unsure" not in row["flags"] and n != frame]
    off = {n: rms(numpy.hypot(*(there[n] - there[frame])[:2])) for n in sure}
    steps = [rms(numpy.hypot(*(there[a] - there[b])[:2])) for a, b in zip(sure, sure[1:])]
    print(f"{len(rows)} sections of a head: {len(there)} laid, {len(sure)} of them surely; one on the "
          f"next to {numpy.median(steps):.2f} px ({laid['gieson']['comparison_px']:.2f} printed)")
    ratio = rms([off[n] / laid["gieson"]["section"][n]["error_px"] for n in sure])
    print(f"  against the frame {rms(off.values()):.2f} px, "
          f"{rms([laid['gieson']['section'][n]['error_px'] for n in sure]):.2f} printed; single "
          f"ones {ratio:.2f} times what is printed, root mean square; worst {max(off.values()):.1f} px")
    return max(off.values()) < 40 and ratio < 3


# ---- panels ------------------------------------------------------------------------------------

def painted(picture, scale):
    """Red and yellow dye by the picture's own optical density, and where there is tissue."""
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    light = numpy.maximum(small.astype(float).mean(2), 1)
    ground = numpy.median(numpy.concatenate([light[:3].ravel(), light[-3:].ravel()]))
    dark = abs(numpy.log10(light / ground))
    density = numpy.clip(dark / numpy.percentile(dark, 98), 0, 1)
    inside = cv2.GaussianBlur((density > .08).astype(float), (0, 0), 2)
    return density, numpy.clip(2 * inside - .5, 0, 1)


def make_panels(folder, pictures, scale, job):
    """The panels' files, and the motion from each reduced picture to its panel."""
    chance = numpy.random.default_rng(2)
    pitch = int(1.15 * max(max(p.shape[:2]) for p in pictures) * scale) + 20
    ways = []
    folder.mkdir()
    for first in range(0, len(pictures), ROWS * COLUMNS):
        density = numpy.zeros((ROWS * pitch, COLUMNS * pitch))
        tissue = density.copy()
        for slot, picture in enumerate(pictures[first:first + ROWS * COLUMNS]):
            d, t = painted(picture, scale)
            centre = (pitch * (slot % COLUMNS + .5), pitch * (slot // COLUMNS + .5))
            way = motion(math.radians(chance.uniform(-12, 12)), False,
                         ((d.shape[1] - 1) / 2, (d.shape[0] - 1) / 2),
                         centre + chance.uniform(-6, 6, 2))
            size = (density.shape[1], density.shape[0])
            density += cv2.warpAffine(d, way[:2], size, flags=cv2.INTER_LINEAR)
            tissue += cv2.warpAffine(t, way[:2], size, flags=cv2.INTER_LINEAR)
            ways.append(way)
        od = (RED * density * tissue)[..., None] * VECTORS[0] + \
            (YELLOW * (1 - .55 * density) * tissue)[..., None] * VECTORS[1]
        rgb = WHITE * 10 ** -od + chance.normal(0, .6, od.shape)
        cv2.imwrite(str(folder / f"P{first // (ROWS * COLUMNS) + 1:02d}.png"),
                    numpy.clip(rgb + .5, 0, 255).astype(numpy.uint8)[..., ::-1])
    (folder / "job.json").write_text(json.dumps(
        {"px_um": PX_UM, "transfer": "linear", "layout": [ROWS, COLUMNS],
         "panels": -(-len(pictures) // (ROWS * COLUMNS)), "sections": len(pictures),
         "registration": "tissue", **job}))
    return ways


def report_of(programs, place, name):
    store = place / "store"
    gieson(programs, "import", place / name, store=store)
    gieson(programs, "run", store=store)
    return json.loads(gieson(programs, "report", name, "--json", store=store))


def to_block(section, way):
    m = section["panel_to_block_um"]
    pixel = matrix([[1, 0, .5], [0, 1, .5]])
    return matrix([m[:3], m[3:]]) @ pixel @ way


def tell(report):
    done = report["registration"]
    used = sum(s["state"] == "used" for s in report["sections"])
    print(f"  {report['specimen']}: {report['verdict']}; {used} of {done['sections_expected']} "
          f"sections used, one on the next to {done['comparison_um']:.1f} um (printed), mean density "
          f"{report['region']['mean_density']}")
    return used


def panels_of_a_head(programs, place, name, share, wanted):
    """share: of its width, from the left; half a head is not its own mirror image."""
    pictures = [p[:, :int(share * p.shape[1])] for p in head(16, 40)]
    ways = make_panels(place / name, pictures, .5,
                       {"specimen": name, "region": {"kind": "band", "from": "tissue",
                                                       "low_um": -100000, "high_um": 0}})
    report = report_of(programs, place, name)
    used = tell(report)
    points = grid_of([s // 2 for s in pictures[0].shape[:2]])
    there = [to_block(s, ways[i]) @ points if s["state"] == "used" else None
             for i, s in enumerate(report["sections"][:len(pictures)])]
    steps = [rms(numpy.hypot(*(a - b)[:2])) for a, b in zip(there, there[1:])
             if a is not None and b is not None]
    print(f"    neighbours lie {numpy.median(steps):.1f} um apart in the median, {max(steps):.1f} at "
          f"worst; pixels of {PX_UM:g} um")
    return report["verdict"] != "withheld" and used >= wanted and max(steps) < 5 * PX_UM


def panels_of_a_lung(programs, place):
    pictures, marks = lung()
    scale = .4
    ways = make_panels(place / "lung", [cv2.imread(str(p)) for p in pictures], scale,
                       {"specimen": "lung", "region": {"kind": "band", "from": "tissue",
                                                       "low_um": -100000, "high_um": 0}})
    report = report_of(programs, place, "lung")
    used = tell(report)
    there = []
    for i, s in enumerate(report["sections"][:len(pictures)]):
        small = (marks[i] + .5) * scale - .5
        if s["state"] == "used":
            there.append((to_block(s, ways[i]), small))
    off, least = [], []
    for i, (a, p) in enumerate(there):
        for b, q in there[:i]:
            u, v = (m @ numpy.column_stack([x, numpy.ones(len(x))]).T for m, x in ((a, p), (b, q)))
            off.append(rms(numpy.hypot(*(u - v)[:2])) / PX_UM / scale)
            least.append(rms(at_marks(best_rigid(p, q), p, q)) / scale)
    if off:
        print(f"    landmarks {numpy.mean(off):.2f} px of the pictures, {numpy.mean(least):.2f} for "
              f"the best rigid motions of the landmarks")
    return report["verdict"] != "withheld" and used >= 3 and \
        numpy.mean(off) < 1.5 * numpy.mean(least)


def panels(programs):
    print("from panels to a report by tissue")
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        good = [panels_of_a_head(programs, place, "head", 1, 2),
                panels_of_a_head(programs, place, "half", .5, 20), panels_of_a_lung(programs, place)]
    return all(good)


def main():
    programs = pathlib.Path(sys.argv[1]).resolve()
    if not STACKS.is_dir():
        print(f"{STACKS} is not there")
        return SKIPPED
    good = [{"landmarks": landmarks, "moved": moved, "panels": panels}[what](programs)
            for what in sys.argv[2:] or ("landmarks", "moved", "panels")]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
