#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The whole way, run as a user would run it: panels in a folder, gieson, report.json; every figure
against the phantom's truth or against the same work done another way.

    whole.py BIN accuracy --level L1 --seed 1 [--seed 2 ...] [--specimen S02 ...]
    whole.py BIN loss --level L3-whole --seed 23 [--specimen S02 ...] [--ready DIR] [--calibrated]
                               the loss: near the truth and its interval holds it, or, at L3 and
                               L3-whole, withheld with a reason; S03 and S04 move it little; --calibrated: the
                               batches' calibration panels are stated
    whole.py BIN identical     two stores, 1 and 2 threads: the same bytes; `gieson verify` agrees
    whole.py BIN killed        gieson-work killed at ten moments: the same report
    whole.py BIN awkward       refused panels cost only themselves
    whole.py BIN volume        the molar CT of ../shared
    whole.py BIN tile          the picrosirius tile of ../shared
    whole.py BIN marks --level L2 --seed 7 [--specimen S02] [--ready DIR]
                               marks and poses (registration.py); DIR/LEVEL/SEED/SPECIMEN made before;
                               --sound: only that nothing wrong is used, however much is found;
                               a panel that was scanned twice is answered as a person would, with
                               the second scan

BIN is the folder with the programs. Exit 0: all that was demanded holds; 77: material is missing.
"""
import argparse
import collections
import csv
import hashlib
import json
import math
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "phantom"))
import recompute_loss  # noqa: E402  (the phantom's block, written a second time)
import registration  # noqa: E402

SHARED = pathlib.Path(__file__).resolve().parents[3] / "shared"
SKIPPED = 77

# level -> largest RMS registration error over the region in um, largest error of the loss in points,
# largest relative error of the fitted volume above 0.5
DEMANDED = {"L0": (2.0, 0.5, 0.02), "L1": (4.0, 1.0, 0.03)}
# level -> largest error of a loss that is given, and by how much another stain may move it, points
LOSS_WITHIN = {"L2": (2.0, 1.5), "L3": (4.0, 3.0), "L3-whole": (4.0, 3.0)}
# Where a loss may be withheld with a reason instead.
MAY_WITHHOLD = ("L3", "L3-whole")
REGION_CENTRE, REGION_RADIUS = (411.0, 646.0), 900.0
REGION_SERIALS = range(5, 30)


class Bench:
    """One folder with scans and a store."""

    def __init__(self, bin_folder, folder):
        self.bin = pathlib.Path(bin_folder).resolve()
        self.folder = pathlib.Path(folder)
        self.store = self.folder / "store"

    def call(self, *args, check=True, **more):
        command = [str(self.bin / "gieson"), "--store", str(self.store), *map(str, args)]
        done = subprocess.run(command, capture_output=True, text=True, **more)
        if check and done.returncode != 0:
            raise SystemExit(f"{' '.join(command)}\nended with {done.returncode}\n"
                             f"{done.stdout}{done.stderr}")
        return done

    def phantom(self, specimen, level, seed, *more):
        out = self.folder / f"GVP-D-{specimen}"
        self.call("phantom", "--specimen", specimen, "--level", level, "--seed", seed, "--out", out, *more)
        return out

    def report(self, specimen):
        return json.loads(self.call("report", specimen, "--json").stdout)

    def report_files(self, specimen):
        html, text = self.call("report", specimen).stdout.splitlines()[1:3]
        return pathlib.Path(html).read_bytes(), pathlib.Path(text).read_bytes()


def truth_rows(folder, name):
    with open(folder / "truth" / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def invert(m):
    a, b, c, d, e, f = m
    det = a * e - b * d
    return (e / det, -b / det, (b * f - c * e) / det, -d / det, a / det, (c * d - a * f) / det)


def region_points():
    """A ring-filling grid of the region's disc."""
    steps = [REGION_RADIUS * i / 6 for i in range(-6, 7)]
    return [(REGION_CENTRE[0] + x, REGION_CENTRE[1] + y) for x in steps for y in steps
            if math.hypot(x, y) <= REGION_RADIUS]


def registration_rms(report, folder):
    """RMS distance between where our map and the true one put the region, over its sections."""
    truth = {int(row["k"]): row for row in truth_rows(folder, "sections.csv")}
    squares, count = 0.0, 0
    for section in report["sections"]:
        if section["serial"] not in REGION_SERIALS or section["panel_to_block_um"] is None:
            continue
        row = truth[section["serial"]]
        to_panel = [float(row[k]) for k in ("m00", "m01", "m02", "m10", "m11", "m12")]
        m = section["panel_to_block_um"]
        for x, y in region_points():
            px = to_panel[0] * x + to_panel[1] * y + to_panel[2]
            py = to_panel[3] * x + to_panel[4] * y + to_panel[5]
            squares += (m[0] * px + m[1] * py + m[2] - x) ** 2
            squares += (m[3] * px + m[4] * py + m[5] - y) ** 2
            count += 1
    return math.sqrt(squares / count)


def marks_wrong(report, folder):
    """How many of the truth's visible marks are missing, misnumbered or off by more than 1 px."""
    sections = {s["serial"]: s for s in report["sections"]}
    wrong = 0
    for row in truth_rows(folder, "markers.csv"):
        if row["visible"] != "1":
            continue
        found = sections[int(row["k"])]["markers_px"][int(row["marker"]) - 1]
        if not found or found[0] is None or \
                math.hypot(found[0] - float(row["x_px"]), found[1] - float(row["y_px"])) > 1.0:
            wrong += 1
    return wrong


# Of a page with 60 sections, bytes.
MOST_PAGE = 3e6
# Of cells of the map of the loss: how many intervals hold the truth at least; what the cells are off
# by, in their own standard errors (root of the mean square), which texture that is no error makes
# larger.
CELLS_HELD, CELLS_OFF = 0.90, (0.5, 1.3)
# Or in points: drawn sections without noise (L0) err by nothing of their own, and what is left is
# common to all of them.
CELLS_POINTS = 1.5
# Axes by falling fraction, as measure/base_cells.h numbers the tetrahedra of a cube.
TETS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


def cells_told(place, report, folder, specimen):
    """(how often the interval of a cell's loss holds what the phantom lost there, what cells are off
    by in standard errors, both in words, the same in points); None for a control. Cells are found and filled a second
    time here."""
    if not report["loss_map"]:
        return None
    with open(folder / "truth" / "truth.json", encoding="utf-8") as file:
        block = recompute_loss.Block(json.load(file))
    key, step = report["loss_map"]["edge_um"], 20.0
    truth = collections.defaultdict(lambda: [0.0, 0.0])
    for point in block.region(step):
        cube = [math.floor(x / key) for x in point]
        order = sorted(range(3), key=lambda a: cube[a] - point[a] / key)
        before, after = block.densities(*point)
        cell = truth[(*cube, TETS.index(tuple(order)))]
        cell[0] += before
        cell[1] += after
    rows = place.folder / "store" / "reports" / specimen / "latest" / "base-cells.csv"
    off, points = [], []
    with open(rows, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            cell = truth.get(tuple(int(row[k]) for k in ("cube_x", "cube_y", "cube_z", "tet")))
            # One that the region's border cuts off has too few midpoints here.
            if not row["loss_percent"] or not cell or float(row["volume_um3"]) < key**3 / 12:
                continue
            lost = 100 * (1 - cell[1] / cell[0])
            points.append(float(row["loss_percent"]) - lost)
            off.append(points[-1] / float(row["loss_error"]))
    held = sum(abs(z) <= 1.96 for z in off) / max(1, len(off))
    rms, apart = [math.sqrt(sum(z * z for z in list_) / max(1, len(list_)))
                  for list_ in (off, points)]
    return held, rms, (f"held {100 * held:.1f} % of {len(off)}, off by {rms:.2f} of their errors, "
                       f"{apart:.2f} points"), apart


def accuracy(bench, args):
    failed = 0
    worst_rms, worst_loss, worst_volume = 0.0, 0.0, 0.0
    for seed in args.seed or [1]:
        place = Bench(bench.bin, bench.folder / f"{args.level}-{seed}")
        # Without a calibration panel a loss is known to some nine points (coverage.py).
        variant = place.folder / "calibration.json"
        place.folder.mkdir(parents=True, exist_ok=True)
        variant.write_text('{"calibration": true}')
        folders = {s: place.phantom(s, args.level, seed, "--variant", variant, "--px", args.px)
                   for s in ["S00", *args.specimen]}
        for folder in folders.values():
            place.call("import", folder)
        began = time.monotonic()
        place.call("run")
        took = time.monotonic() - began
        for specimen, folder in folders.items():
            report = place.report(f"GVP-D-{specimen}")
            truth = truth_rows(folder, "loss.csv")[0]
            rms = registration_rms(report, folder)
            wrong = marks_wrong(report, folder)
            loss = report["loss_percent"]
            error = 0.0 if specimen == "S00" else abs(loss - float(truth["loss_pct"]))
            cells = cells_told(place, report, folder, f"GVP-D-{specimen}")
            half = next(v for v in report["volumes"] if v["threshold"] == 0.5)
            volume = 0.5 * (half["lower_mm3"] + half["upper_mm3"]) / float(truth["V_gt_0.5"]) - 1
            limits = DEMANDED[args.level]
            linked = specimen == "S00" or \
                any(m["name"].startswith("Stain against the baseline") for m in report["measures"])
            weight = (place.folder / "store" / "reports" / f"GVP-D-{specimen}" / "latest" /
                      "report.html").stat().st_size
            good = (linked and weight <= MOST_PAGE and rms <= limits[0] and error <= limits[1]
                    and abs(volume) <= limits[2] and wrong == 0 and len(report["sections"]) == 60
                    and (not cells or cells[3] <= CELLS_POINTS
                         or (cells[0] >= CELLS_HELD and CELLS_OFF[0] <= cells[1] <= CELLS_OFF[1])))
            failed += not good
            worst_rms, worst_loss = max(worst_rms, rms), max(worst_loss, error)
            worst_volume = max(worst_volume, abs(volume))
            print(f"{args.level} seed {seed} {specimen}: registration {rms:.3f} um, marks wrong "
                  f"{wrong}, loss {loss if loss is not None else 'control'} "
                  f"(error {error:.3f} points), V(0.5) {100 * volume:+.2f} %"
                  f"{', cells ' + cells[2] if cells else ''}, page {weight / 1e6:.2f} MB"
                  f"{'' if linked else ', not compared with the baseline by untreated tissue'}"
                  f"{'' if good else '   NOT MET'}", flush=True)
        print(f"  run of {len(folders)} specimens: {took:.1f} s", flush=True)
    print(f"worst: registration {worst_rms:.3f} um, loss {worst_loss:.3f} points, "
          f"V(0.5) {100 * worst_volume:.2f} %")
    return 1 if failed else 0


def answer(place, specimen):
    """What a person is asked who has both scans in hand. Returns the answers given."""
    shown = json.loads(place.call("show", specimen, "--json").stdout)
    files, given = {}, []
    for panel in shown["panels"]:
        files.setdefault(panel["number"], []).append(panel)
    for number, panels in sorted(files.items()):
        if len(panels) > 1 and all("show the same glass" in p["message"] for p in panels):
            given.append((number, "use", max(p["file"] for p in panels)))
    for words in given:
        place.call("decide", specimen, *words)
    return given


def marks(bench, args):
    """Marks and poses of phantoms with everything that goes wrong at a bench."""
    failed = 0
    for seed in args.seed or [1]:
        for specimen in args.specimen:
            place = Bench(bench.bin, bench.folder / f"{args.level}-{seed}-{specimen}")
            folder = pathlib.Path(args.ready) / args.level / str(seed) / specimen if args.ready \
                else place.phantom(specimen, args.level, seed)
            place.call("import", folder)
            place.call("run", check=False)
            answers = answer(place, f"GVP-D-{specimen}")
            if answers:
                place.call("run", check=False)
            print(f"{args.level} seed {seed} {specimen}:", *(" ".join(map(str, a)) for a in answers),
                  flush=True)
            failed += not registration.judge(place.report(f"GVP-D-{specimen}"),
                                             registration.Truth(folder / "truth"), args.level,
                                             verbose=True, sound_only=args.sound)
    return 1 if failed else 0


def state_calibration(folder):
    """What an operator types who has stained and scanned a glass with each batch."""
    job = json.loads((folder / "job.json").read_text())
    job["calibration"] = []
    for i, panel in enumerate(sorted((folder / "calibration").glob("*-C*"))):
        shutil.copy(panel, folder)
        job["calibration"].append({"file": panel.name, "panels": [i + 1],
                                   "patches": [[0, 0.25, 0.5, 0.75, 1], ["red", "yellow", "dark"]]})
    (folder / "job.json").write_text(json.dumps(job))


def judge_loss(report, truth, level, name):
    """Whether a loss is right, or withheld with a reason. Returns it, or None, and the verdict."""
    loss, interval = report["loss_percent"], report["loss_interval"]
    if loss is None:
        good = level in MAY_WITHHOLD and bool(report["loss_reason"])
        print(f"{name}: withheld: {report['loss_reason']}{'' if good else '   NOT MET'}", flush=True)
        return None, good
    good = abs(loss - truth) <= LOSS_WITHIN[level][0] and \
        interval["lower"] <= truth <= interval["upper"]
    print(f"{name}: loss {loss:.2f} ({interval['lower']:.2f} to {interval['upper']:.2f}), true "
          f"{truth:.2f}{'' if good else '   NOT MET'}", flush=True)
    return loss, good


def loss(bench, args):
    failed, withheld = 0, 0
    for seed in args.seed or [1]:
        place = Bench(bench.bin, bench.folder / f"{args.level}-{seed}")
        found = {}
        for specimen in ["S00", *args.specimen]:
            folder = place.folder / f"GVP-D-{specimen}"
            if args.ready:
                shutil.copytree(pathlib.Path(args.ready) / args.level / str(seed) / specimen, folder)
            else:
                place.phantom(specimen, args.level, seed)
            if args.calibrated:
                state_calibration(folder)
            place.call("import", folder)
        place.call("run", check=False)
        for specimen in args.specimen:
            truth = float(truth_rows(place.folder / f"GVP-D-{specimen}", "loss.csv")[0]["loss_pct"])
            found[specimen], good = judge_loss(place.report(f"GVP-D-{specimen}"), truth, args.level,
                                               f"{args.level} seed {seed} {specimen}")
            # With calibration panels there is no reason to withhold it.
            failed += not good or (args.calibrated and found[specimen] is None)
            withheld += found[specimen] is None
        for specimen in {"S03", "S04"} & found.keys():
            moved = (found[specimen] or math.nan) - (found.get("S02") or math.nan)
            if abs(moved) > LOSS_WITHIN[args.level][1]:
                failed += 1
                print(f"{specimen}: another stain moves the loss by {moved:+.2f}   NOT MET")
    print(f"{failed} not met, {withheld} withheld")
    return 1 if failed else 0


def identical(bench, args):
    stores = []
    scans = [bench.phantom(specimen, "L0", 3, "--px", 24) for specimen in ("S00", "S02")]
    for threads in (1, 2):
        place = Bench(bench.bin, bench.folder / f"threads-{threads}")
        for folder in scans:
            place.call("import", folder)
        place.call("run", "--threads", threads)
        stores.append(place)
    for specimen in ("GVP-D-S00", "GVP-D-S02"):
        first, second = (s.report_files(specimen) for s in stores)
        print(f"{specimen}: html {hashlib.sha256(first[0]).hexdigest()[:16]} "
              f"{hashlib.sha256(second[0]).hexdigest()[:16]}, json "
              f"{hashlib.sha256(first[1]).hexdigest()[:16]} "
              f"{hashlib.sha256(second[1]).hexdigest()[:16]}")
        if first != second:
            print("1 and 2 threads differ")
            return 1
    print(stores[0].call("verify", "GVP-D-S02").stdout.strip())
    return 0


def workers(place):
    """gieson-work processes on this store."""
    found = []
    for entry in os.listdir("/proc"):
        try:
            words = pathlib.Path(f"/proc/{entry}/cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if words[0].endswith(b"gieson-work") and str(place.store).encode() in words:
            found.append(int(entry))
    return found


def run_and_kill(place, wanted, longest, rng):
    """Runs the queue to its end; up to that many of its workers are killed on the way."""
    kills, ended = 0, None
    while ended != 0 and kills < wanted:
        runner = subprocess.Popen([str(place.bin / "gieson"), "--store", str(place.store), "run"],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while runner.poll() is None and kills < wanted:
            time.sleep(rng.uniform(0.02, 0.3) * longest)
            for pid in workers(place):
                os.kill(pid, signal.SIGKILL)
                kills += 1
        ended = runner.wait()
        # Jobs that died five times are given up until a person asks again.
        place.call("retry")
    place.call("run")
    return kills


def killed(bench, args):
    rng = random.Random(20)
    calm = Bench(bench.bin, bench.folder / "calm")
    scans = [calm.phantom(s, "L0", 5) for s in ("S00", "S02")]
    for folder in scans:
        calm.call("import", folder)
    began = time.monotonic()
    calm.call("run")
    whole = time.monotonic() - began
    kills, stores, longest = 0, 0, whole
    # What is done is not done again: a queue that ends before the tenth kill leaves the rest of
    # them to another store.
    while kills < 10:
        rough = Bench(bench.bin, bench.folder / f"rough-{stores}")
        stores += 1
        for folder in scans:
            rough.call("import", folder)
        more = run_and_kill(rough, 10 - kills, longest, rng)
        kills += more
        longest = longest if more else longest / 2  # it is faster than it was
        for specimen in ("GVP-D-S00", "GVP-D-S02"):
            if calm.report_files(specimen) != rough.report_files(specimen):
                print(f"{specimen}: the report after {kills} kills differs")
                return 1
    print(f"{kills} kills, {stores} store(s), runs of {whole:.1f} s: the same reports as undisturbed")
    return 0


def awkward(bench, args):
    """Good panels beside damaged ones: the damaged are named, the good are worked."""
    images = SHARED / "data" / "images"
    if not images.is_dir():
        print("skipped: ../shared/data/images is not there")
        return SKIPPED
    place = Bench(bench.bin, bench.folder)
    folder = place.phantom("S00", "L0", 1)
    job = json.loads((folder / "job.json").read_text())
    names = sorted(p.name for p in images.iterdir() if p.suffix in (".tif", ".tiff", ".jpg", ".png"))
    for i, name in enumerate(names):
        shutil.copy(images / name, folder / f"awkward-{name}")
    (folder / "job.json").write_text(json.dumps(job))
    place.call("import", folder)
    began = time.monotonic()
    place.call("run", check=False)
    shown = json.loads(place.call("show", "GVP-D-S00", "--json").stdout)
    states = {p["file"]: p for p in shown["panels"]}
    bad = 0
    for panel in shown["panels"]:
        line = f"{panel['file']}: {panel['state']}: {panel['message']}"
        print(line)
        if panel["file"].startswith("awkward"):
            bad += panel["state"] not in ("refused", "held") or not panel["message"]
        else:
            bad += panel["state"] != "registered"
    for name in names:
        if f"awkward-{name}" not in states:
            same = [p for p in states if p.startswith("awkward")]
            print(f"awkward-{name}: not logged (the same bytes as another?) {len(same)}")
    report = place.report("GVP-D-S00")
    used = sum(s["state"] == "used" for s in report["sections"])
    print(f"{len(names)} awkward files beside 5 good panels: {used} sections used, "
          f"{time.monotonic() - began:.0f} s")
    return 1 if bad or used != 60 else 0


def volume(bench, args):
    tooth = SHARED / "data" / "volumes" / "tooth.mhd"
    if not tooth.is_file():
        print("skipped: ../shared/data/volumes/tooth.mhd is not there")
        return SKIPPED
    place = Bench(bench.bin, bench.folder)
    began = time.monotonic()
    place.call("import", "--volume", tooth, "--threshold", 100, "--spacing-unit", "um")
    place.call("run")
    report = place.report("tooth")
    bound = report["volumes"][0]
    voxels = [1e9 * bound[k] for k in ("lower_mm3", "upper_mm3")]
    off = 0.5 * sum(voxels) / 370594.5 - 1
    print(f"V(I > 100): {voxels[0]:.1f} to {voxels[1]:.1f} voxels, {100 * off:+.2f} % of 370594.5; "
          f"{time.monotonic() - began:.0f} s; {report['fit']}")
    return 0 if abs(off) <= 0.02 else 1


def tile(bench, args):
    colour = SHARED / "data" / "colour"
    if not colour.is_dir():
        print("skipped: ../shared/data/colour is not there")
        return SKIPPED
    place = Bench(bench.bin, bench.folder)
    place.call("import", "--tile", colour / "psr_left.jpg", "--reference", "psr_left_mask.jpg",
               "--specimen", "psr")
    place.call("run")
    report = place.report("psr")
    print(json.dumps(report.get("tile"), indent=1))
    return 0 if report["tile"]["mask"]["dice"] >= 0.8 else 1


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin")
    parser.add_argument("what", choices=["accuracy", "loss", "identical", "killed", "awkward", "volume",
                                         "tile", "marks"])
    parser.add_argument("--level", default="L0")
    parser.add_argument("--seed", type=int, action="append")
    parser.add_argument("--specimen", action="append")
    parser.add_argument("--px", type=float, default=10.58, help="accuracy: um a pixel")
    parser.add_argument("--sound", action="store_true",
                        help="marks: fail on what is wrong and used, not on what was not found")
    parser.add_argument("--ready", help="a folder with phantoms made before")
    parser.add_argument("--calibrated", action="store_true",
                        help="loss: with a calibration panel for each batch")
    parser.add_argument("--keep", help="a folder to work in and leave behind")
    args = parser.parse_args()
    args.specimen = args.specimen or ["S01", "S02"]
    if args.keep:
        return globals()[args.what](Bench(args.bin, args.keep), args)
    with tempfile.TemporaryDirectory(prefix="gieson-whole-") as folder:
        return globals()[args.what](Bench(args.bin, folder), args)


if __name__ == "__main__":
    sys.exit(main())
