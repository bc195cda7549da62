#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Laser marks of other sizes and kinds than the phantom's, among spots that are none.

    marks.py BIN table  [--seed N]... [--px UM]... [--keep FOLDER]   discs and holes of 20 to 300 um
    marks.py BIN decoys [--seed N]... [--keep FOLDER]                0 to 60 round spots a section
    marks.py BIN none   [--seed N]... [--keep FOLDER]                no marks, 0 to 30 spots a section
    marks.py BIN sizes  [--seed N]... [--px UM]... [--keep FOLDER]   sections that differ in size

BIN is the programs' folder. Tissue, outline, debris and light are those of the generator in
../shared/peers; burns are drawn here: ovals up to 1.6 to 1 with a lobed edge, a hole with a charred
rim of a fifth to a third of its radius. Nothing is stated but the pixel size. A section counts as
found where its pose puts all three marks within 1.5 pixels, or 0.15 radii, of their places, in the
frame that most sections agree on; as wrong where it does not and no flag says so. Sizes differ by a
normal factor of 0, 0.5, 2 and 5 %, the marks are stated, and the errors at the five points of each
section are held against its ellipses. Exit 1: less than 98 % found of marks of two pixels (holes: four)
and more, any wrong, or ellipses that hold what they should with less than one chance in a thousand;
77: ../shared or python3-opencv is missing."""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

SKIPPED = 77
DEBIANS = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]
GENERATOR = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared")) / "peers" / "gen"
sys.path.insert(0, str(GENERATOR))
try:
    import cv2
    import numpy
    import gen_sections
except ImportError:
    if sys.executable != DEBIANS and os.path.exists(DEBIANS):
        os.execv(DEBIANS, [DEBIANS, *sys.argv])
    print(f"SKIPPED: python3-opencv or {GENERATOR} is not there")
    sys.exit(SKIPPED)

RADII_UM = (20, 40, 75, 150, 300)
BLOCK_UM = 7500
PAPER = numpy.array([238, 236, 234], numpy.float32)
CHAR = numpy.array([48, 36, 44], numpy.float32)
FINER = 4  # samples of a pixel's side
BLUR_PX = 0.6


def burn(picture, at, radius, chance, hole, aspect, rim):
    """radius in pixels, the geometric mean of the half axes; blurred as by optics."""
    reach = int(radius * 1.7 + 6)
    x0, y0 = int(round(at[0])) - reach, int(round(at[1])) - reach
    n = 2 * reach + 1
    if x0 < 0 or y0 < 0 or x0 + n > picture.shape[1] or y0 + n > picture.shape[0]:
        return
    step = (numpy.arange(n * FINER) + .5) / FINER - .5
    x, y = numpy.meshgrid(x0 + step - at[0], y0 + step - at[1])
    turn, longer = chance.uniform(0, numpy.pi), numpy.sqrt(aspect)
    u = (numpy.cos(turn) * x + numpy.sin(turn) * y) / (radius * longer)
    v = (numpy.cos(turn) * y - numpy.sin(turn) * x) / (radius / longer)
    angle, far = numpy.arctan2(v, u), numpy.hypot(u, v)
    edge = 1 + sum(c * numpy.cos(2 * (i + 1) * angle) + d * numpy.sin(2 * (i + 1) * angle)
                   for i, (c, d) in enumerate(chance.normal(0, .02, (2, 2))))

    def share(inside):
        mean = inside.reshape(n, FINER, n, FINER).mean((1, 3)).astype(numpy.float32)
        return cv2.GaussianBlur(mean, (0, 0), BLUR_PX)[..., None]

    char = .96 * share(far < edge)
    picture[y0:y0 + n, x0:x0 + n] = picture[y0:y0 + n, x0:x0 + n] * (1 - char) + CHAR * char
    if hole:
        light = share(far < edge * (1 - rim))
        picture[y0:y0 + n, x0:x0 + n] = picture[y0:y0 + n, x0:x0 + n] * (1 - light) + PAPER * light


def draw_section(tissue, i, seed, px_um, spots):
    """spots: radius_um, hole, marks, decoys, standard deviation of the size in per cent. The tissue of
    section i is drawn once for all of them."""
    side = int(round(BLOCK_UM / px_um))
    k = side / 1500
    base = tissue.render(i)
    for radius_um, hole, marks, decoys, sizes in spots:
        chance = numpy.random.RandomState((seed * 100003 + i) % 2**32)
        angle, shift = chance.uniform(-180, 180), chance.uniform(-40, 40, 2) * k
        face = -1.0 if chance.uniform() < .15 else 1.0
        c, s = numpy.cos(numpy.radians(angle)), numpy.sin(numpy.radians(angle))
        size = 1 + sizes / 100 * numpy.random.RandomState((seed * 7919 + i) % 2**32).normal()
        turn = size * numpy.array([[c * face, -s], [s * face, c]])
        middle = numpy.array([(side - 1) / 2] * 2)
        centre = middle + shift
        motion = numpy.hstack([turn, (centre - turn @ middle)[:, None]])
        picture = cv2.warpAffine(base, motion, (side, side), flags=cv2.INTER_CUBIC,
                                 borderValue=PAPER.tolist()).astype(numpy.float32)
        gain, slope = chance.uniform(.92, 1.06, 3), chance.uniform(-.05, .05, 2)
        places = (turn @ (gen_sections.CANON * k).T).T + centre
        for place in places if marks else ():
            burn(picture, place, radius_um / px_um * chance.uniform(.92, 1.08), chance, hole,
                 chance.uniform(1, 1.6), chance.uniform(.18, .3))
        for _ in range(chance.randint(0, 6)):
            gen_sections.draw_disc(picture, chance.uniform(.08, .92, 2) * side,
                                   chance.uniform(3, 12) * k, (60, 50, 55), chance.uniform(.6, .95),
                                   chance.normal(0, .12, (3, 2)))
        for _ in range(decoys):
            burn(picture, chance.uniform(.12, .88, 2) * side,
                 radius_um / px_um * chance.uniform(.9, 1.1), chance, hole, chance.uniform(1, 1.2),
                 .25)
        x = numpy.linspace(-1, 1, side, dtype=numpy.float32)
        picture *= gain.astype(numpy.float32)
        picture *= (1 + slope[0] * x[None, :] + slope[1] * x[:, None])[..., None]
        picture += chance.standard_normal(picture.shape).astype(numpy.float32) * 3
        yield (numpy.clip(numpy.rint(picture), 0, 255).astype(numpy.uint8), motion_of(turn, centre),
               places.tolist())


def motion_of(turn, centre):
    """From the generator's frame, its origin in the middle, to the picture."""
    return numpy.hstack([turn, centre[:, None]]).tolist()


def draw_sets(folder, seed, px_um, spots, sections):
    """One folder for each of spots; those that are there are taken as they are."""
    side = int(round(BLOCK_UM / px_um))
    names = [f"{seed}-{px_um:g}um-{'hole' if s[1] else 'disc'}{s[0]}"
             f"{'' if s[2] else '-none'}-decoys{s[3]}"
             f"{f'-sizes{s[4]:g}' if s[4] else ''}" for s in spots]
    missing = [k for k, name in enumerate(names) if not (folder / name / "truth.json").exists()]
    tissue = gen_sections.Tissue(sections, side, seed) if missing else None
    slices = {k: [] for k in missing}
    for i in range(sections if missing else 0):
        wanted = [spots[k] for k in missing]
        for k, (picture, matrix, places) in zip(missing,
                                                draw_section(tissue, i, seed, px_um, wanted)):
            where = folder / names[k]
            where.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(where / f"slice_{i:04d}.png"), picture,
                        [cv2.IMWRITE_PNG_COMPRESSION, 1])
            slices[k].append({"file": f"slice_{i:04d}.png", "matrix": matrix, "markers": places})
    for k in missing:
        (folder / names[k] / "truth.json").write_text(json.dumps(
            {"px": px_um, "canon_px": (gen_sections.CANON * side / 1500).tolist(),
             "slices": slices[k]}))
    return [folder / name for name in names]


def square(rows):
    return numpy.vstack([numpy.asarray(rows, float), [0, 0, 1]])


def score(programs, folder, radius_um):
    """Found, wrong and all sections of a folder, and the median error of those found, pixels."""
    truth = json.loads((folder / "truth.json").read_text())
    done = subprocess.run([programs / "gieson", "--json", "register", folder, "--px-um",
                           str(truth["px"])], capture_output=True, text=True)
    if done.returncode not in (0, 65) or not done.stdout.strip():
        return 0, 0, len(truth["slices"]), float("nan"), done.stderr.strip()
    said = json.loads(done.stdout)
    laid = [s for s in truth["slices"] if s["file"] in said]
    frames = [numpy.linalg.inv(square(s["matrix"])) @ square(said[s["file"]]) for s in laid]
    corners = numpy.array([[0, 1000, 0], [0, 0, 1000], [1, 1, 1]])
    if not laid:
        return 0, 0, len(truth["slices"]), float("nan"), ""
    # The frame is the answer's own: the one nearest to most others.
    apart = [sum(min(abs((a - b)[:2] @ corners).max(), 3) for b in frames) for a in frames]
    usual = numpy.linalg.inv(frames[int(numpy.argmin(apart))])
    canon = numpy.hstack([truth["canon_px"], numpy.ones((3, 1))]).T
    limit, found, wrong, off = max(1.5, .15 * radius_um / truth["px"]), 0, 0, []
    for s in laid:
        places = (square(said[s["file"]]) @ usual @ canon)[:2].T
        worst = numpy.hypot(*(places - s["markers"]).T).max()
        section = said["gieson"]["section"][s["file"]]
        plain = section["state"] == "ok" and not set(section["flags"].split()) - {"flipped",
                                                                                  "rotated180"}
        found += worst <= limit
        wrong += plain and worst > limit
        if worst <= limit:
            off.append(worst)
    return found, wrong, len(truth["slices"]), float(numpy.median(off or [numpy.nan])), ""


def table(o, folder):
    good = True
    for px_um in o.px or (4, 10.58, 24):
        cells = {}
        for seed in o.seed or (900,):
            spots = [(r, hole, 1, 0, 0) for hole in (0, 1) for r in RADII_UM]
            for place, (r, hole, *_) in zip(draw_sets(folder, seed, px_um, spots, 12), spots):
                got = score(o.programs, place, r)
                cells.setdefault((hole, r), []).append(got)
        for hole in (0, 1):
            row = []
            for r in RADII_UM:
                found, wrong, all_ = (sum(g[k] for g in cells[hole, r]) for k in range(3))
                least = 4 if hole else 2
                good &= wrong == 0 and (found >= .98 * all_ or r < least * px_um)
                said = next((g[4] for g in cells[hole, r] if g[4]), "")
                row.append(f"{r} um {found}/{all_}" + (f" WRONG {wrong}" if wrong else "") +
                           (" (refused in words)" if said else ""))
            print(f"{px_um:g} um/px, {'holes' if hole else 'discs'}: " + ", ".join(row), flush=True)
    return good


def decoys(o, folder):
    good = True
    for seed in o.seed or (900,):
        spots = [(75, 0, 1, n, 0) for n in (0, 5, 10, 20, 30, 60)]
        for place, spot in zip(draw_sets(folder, seed, 10.58, spots, 12), spots):
            found, wrong, all_, off, said = score(o.programs, place, 75)
            print(f"seed {seed}, {spot[3]} decoys: found {found} of {all_}, wrong {wrong}, median "
                  f"error {off:.3f} px {said[:90]}", flush=True)
            good &= wrong == 0
    return good


def none(o, folder):
    good = True
    for seed in o.seed or (900,):
        spots = [(75, 0, 0, n, 0) for n in (0, 10, 30)]
        for place, spot in zip(draw_sets(folder, seed, 10.58, spots, 24), spots):
            found, wrong, all_, _, said = score(o.programs, place, 75)
            print(f"seed {seed}, no marks, {spot[3]} spots: {found + wrong} of {all_} laid by marks "
                  f"{said[:90]}", flush=True)
            good &= found + wrong == 0
    return good


def in_ellipses(programs, folder):
    """Of each section with a pose: whether each of its ellipses holds the error there."""
    truth = json.loads((folder / "truth.json").read_text())
    marks = numpy.array(truth["canon_px"]) * truth["px"]
    done = subprocess.run([programs / "gieson", "--json", "register", folder, "--px-um",
                           str(truth["px"]), "--marks",
                           " ".join(f"{x:.6f},{y:.6f}" for x, y in marks)],
                          capture_output=True, text=True)
    said, held = json.loads(done.stdout or "{}"), []
    for s in truth["slices"]:
        section = said.get("gieson", {"section": {}})["section"].get(s["file"], {})
        held.append([])
        for x, y, longer, shorter, angle in section.get("ellipse95_px", ()):
            # The frame is in um, the truth's in pixels.
            found = square(said[s["file"]]) @ [x, y, 1]
            true = square(s["matrix"]) @ [x / truth["px"], y / truth["px"], 1]
            error = numpy.linalg.inv(square(s["matrix"])[:2, :2]) @ (found - true)[:2]
            c, s_ = numpy.cos(numpy.radians(angle)), numpy.sin(numpy.radians(angle))
            held[-1].append(((c * error[0] + s_ * error[1]) / longer) ** 2 +
                            ((c * error[1] - s_ * error[0]) / shorter) ** 2)
    return held, done.stderr.strip()


def sizes(o, folder):
    """The five points of one section err together, so a section counts with the share it holds."""
    good = True
    for px_um in o.px or (24,):
        for seed in o.seed or (900,):
            spots = [(75, 0, 1, 0, percent) for percent in (0, .5, 2, 5)]
            for place, spot in zip(draw_sets(folder, seed, px_um, spots, 96), spots):
                held, said = in_ellipses(o.programs, place)
                shares = [numpy.mean(numpy.array(h) <= 1) for h in held if h]
                if not shares:
                    print(f"seed {seed}, sizes differ by {spot[4]} %: no pose. {said[:90]}")
                    good = False
                    continue
                share, spread = numpy.mean(shares), numpy.std(shares) / len(shares) ** .5
                print(f"seed {seed}, {px_um:g} um/px, sizes differ by {spot[4]} %: {len(shares)} of "
                      f"{len(held)} with a pose, ellipses of 95 % hold {100 * share:.1f} % of errors "
                      f"(+-{100 * spread:.1f})", flush=True)
                good &= share > .95 - 3.3 * max(spread, .22 / len(shares) ** .5)
    return good


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("what", choices=("table", "decoys", "none", "sizes"))
    parser.add_argument("--seed", type=int, action="append")
    parser.add_argument("--px", type=float, action="append")
    parser.add_argument("--keep", type=pathlib.Path, help="folder of the sets; made where missing")
    o = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix="gieson-marks-") as scratch:
        folder = o.keep or pathlib.Path(scratch)
        return 0 if {"table": table, "decoys": decoys, "none": none, "sizes": sizes}[o.what](o, folder) else 1


if __name__ == "__main__":
    sys.exit(main())
