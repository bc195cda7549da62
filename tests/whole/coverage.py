#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""How often the figures hold on specimens that nobody tuned for: other baths, another counterstain,
other blocks, marks and layouts, and an operator's mistakes. Panels in a folder, gieson, report.json.

    coverage.py BIN colour [--sets 12] [--stated nothing free panel] [--results FILE]
                            the loss in baths that no table knows. A set is one bath, one block and
                            three specimens: a control, one that has lost about 40 %, one that has
                            lost nothing. --stated: what the operator knows of the stain; --results:
                            one line a specimen, kept; what is in it is not done again. With
                            --keep the pictures stay and serve the next run; --stated with nothing
                            behind it only makes them
    coverage.py BIN mistakes      label on its head, order, y up, marker_um
    coverage.py BIN marks [--px 4 10.58 24] [--radius 20 40 75 150 300]
    coverage.py BIN decoys [--decoys 0 10 20 40 60]
    coverage.py BIN unmarked      a specimen without marks
    coverage.py BIN tre           the error that is predicted over the region, on three other blocks
    coverage.py BIN frame         what a black frame around the panel costs

Common: --px UM (24), --threads N specimens at a time, --seed N, --keep DIR. Exit 0: nothing that was
printed is wrong; 1: something is; the table says what.
"""
import argparse
import collections
import concurrent.futures
import csv
import json
import math
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile

VARIANTS = pathlib.Path(__file__).resolve().parents[1] / "cases" / "variants"
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "phantom"))
import recompute_loss  # noqa: E402  (the phantom's block, written a second time)
import registration  # noqa: E402

TURNS = (0, 2, 5, 10)
# The middle 95 % of a normal distribution end so many standard errors from its middle.
ENDS = 1.959964
# A loss that is given and is farther off than this is wrong, in points.
WRONG = 2.0


class Bench:
    """Scans and a store; counts the processor time of what it calls."""

    def __init__(self, bin_folder, folder):
        self.bin = pathlib.Path(bin_folder).resolve()
        self.folder = pathlib.Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.seconds = 0.0

    def call(self, *args, check=True):
        command = [str(self.bin / "gieson"), "--store", str(self.folder / "store"), *map(str, args)]
        with tempfile.TemporaryFile() as out:
            child = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            self.seconds = used.ru_utime + used.ru_stime
            out.seek(0)
            said = out.read().decode(errors="replace")
        if check and child.returncode != 0:
            raise SystemExit(f"{' '.join(command)}\nended with {child.returncode}\n{said}")
        return said

    def phantom(self, specimen, level, seed, px_um, variant):
        place = self.folder / f"GVP-D-{specimen}"
        if (place / "job.json").exists():  # it is written last
            return place
        file = self.folder / f"{specimen}.json"
        file.write_text(json.dumps(variant))
        self.call("phantom", "--specimen", specimen, "--level", level, "--seed", seed, "--px", px_um,
                  "--threads", 1, "--variant", file, "--out", place)
        return place

    def work(self, *folders):
        for folder in folders:
            self.call("import", folder)
        self.call("run", "--threads", 1, check=False)

    def report(self, specimen):
        said = self.call("report", f"GVP-D-{specimen}", "--json", check=False)
        try:
            return json.loads(said)
        except json.JSONDecodeError:
            return {"loss_percent": None, "loss_interval": None, "loss_reason": said.strip(),
                    "verdict": "withheld", "verdict_reason": said.strip(), "sections": [],
                    "warnings": []}

    def messages(self, specimen):
        shown = json.loads(self.call("show", f"GVP-D-{specimen}", "--json"))
        return [p["message"] for p in shown["panels"] if p["message"]]


def rows_of(folder, name):
    with open(folder / "truth" / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def true_loss(folder):
    return float(rows_of(folder, "loss.csv")[0]["loss_pct"])


def geometries():
    return [json.loads(file.read_text()) for file in sorted(VARIANTS.glob("geometry-*.json"))]


def at_once(threads, work, things):
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, things))


# --- the loss in another bath ---

Set = collections.namedtuple("Set", "number geometry level turn stain file scatter poor")


def set_of(number):
    """The n-th set. Every four have all turns, every twelve all blocks, and what else there is goes
    round at other rates, so that no two of them go together."""
    level = "L2" if number % 3 == 1 else "L1"
    return Set(number=number, geometry=(5 * number + number // 12) % 12, turn=TURNS[number % 4],
               level=level, stain="haematoxylin" if number % 5 == 3 else "dark",
               file="JPEG 85" if number // 4 % 2 else "PNG",
               scatter=2 if level == "L2" else (0, 0.5)[number // 3 % 2], poor=number % 7 != 6)


def variant_of(drawn):
    variant = dict(geometries()[drawn.geometry])
    block = variant.get("block", "D")
    variant["block"] = {**(block if isinstance(block, dict) else {"like": block}),
                        "marrow_density": 0}
    variant.update(bath_turn_deg=drawn.turn, bath_seed=drawn.number + 1,
                   jpeg_quality=85 if drawn.file == "JPEG 85" else None)
    if drawn.level == "L1":  # L2 has two degrees of its own
        variant["panel_turn_deg"] = drawn.scatter
    if drawn.stain == "haematoxylin":
        variant["counterstain"] = "haematoxylin"
    if not drawn.poor:
        variant["collagen_floor"] = 0.3
    return variant


def free_tissue(folder):
    """A cylinder in the largest marrow space of the block that lies whole in the bone and off the
    region: tissue of which an anatomist knows that it holds no collagen."""
    truth = json.loads((folder / "truth" / "truth.json").read_text())
    block = recompute_loss.Block(truth)
    g, lesion, best = truth["geometry"], truth["lesion"]["centre"], None
    for x, y, z, rx, ry, rz in g["marrow"]:
        radius = 0.6 * min(rx, ry)
        d = block.distance(x, y, z)
        ox, oy = block.axis(z)
        wide = g["wb0"] * (1 + g["wb1"] * math.cos(math.atan2(y - oy, x - ox) - g["wbt"]))
        inside = d - radius > g["wpdl"] and d + radius < g["wpdl"] + wide and \
            block.tissue(x, y, z) == 1 and 0.6 * rz < z < g["H"] - 0.6 * rz
        off = math.hypot(x - lesion[0], y - lesion[1]) > g["region"]["radius"] + radius or \
            abs(z - lesion[2]) > g["region"]["half_height"] + 0.6 * rz
        if inside and off and (best is None or radius > best["radius"]):
            best = {"shape": "cylinder", "centre": [x, y], "radius": radius,
                    "z": [z - 0.6 * rz, z + 0.6 * rz]}
    return best


def state(folder, stated):
    """What the operator types beside what the phantom wrote."""
    job = json.loads((folder / "job.json").read_text())
    if stated != "panel":  # nor does it come in as one more panel of sections
        (folder / job.pop("calibration")).unlink()
    if stated == "free":
        job["collagen_free"] = free_tissue(folder)
    (folder / "job.json").write_text(json.dumps(job))


def judge(report, truth):
    """reported, bounded or withheld, and by how much it is off."""
    loss, interval = report["loss_percent"], report["loss_interval"] or {}
    low, high = interval.get("lower"), interval.get("upper")
    found = {"true": truth, "loss": loss, "lower": low, "upper": high,
             "reason": report["loss_reason"], "state": "reported"}
    at_most = re.search(r"at most (-?[0-9.]+) %", report["loss_reason"] or "")
    if loss is None and high is None and at_most:
        found["upper"] = high = float(at_most[1])
    if loss is None or low is None:
        found["state"] = "withheld" if high is None else "bounded"
        if high is not None:
            found["covered"] = truth <= high
        return found
    error = loss - truth
    half = (loss - low if error > 0 else high - loss) / ENDS
    found.update(covered=low <= truth <= high, error=error, width=high - low,
                 errors=error / half if half > 0 else math.copysign(99, error) if error else 0)
    return found


def work_set(bin_folder, folder, number, stated, args, say):
    """Makes one set and works it once for each statement."""
    drawn = set_of(number)
    variant = {**variant_of(drawn), "calibration": True}
    maker = Bench(bin_folder, folder / f"set-{number}")
    loss = {"S00": 1, "S02": variant.get("loss", 1), "S01": 0}
    made = {s: maker.phantom(s, drawn.level, 1000 + args.seed + number, args.px[0],
                             {**variant, "loss": loss[s]}) for s in loss}
    for how in stated:
        place = Bench(bin_folder, folder / f"set-{number}-{how}")
        copies = {s: shutil.copytree(made[s], place.folder / made[s].name) for s in made}
        for copy in copies.values():
            state(copy, how)
        place.work(*copies.values())
        for specimen in ("S02", "S01"):
            say({**drawn._asdict(), "stated": how, "specimen": specimen,
                 **judge(place.report(specimen), true_loss(made[specimen]))})
        shutil.rmtree(place.folder)
    if not args.keep:
        shutil.rmtree(maker.folder)


def show_row(name, rows):
    given = [r for r in rows if r["state"] == "reported"]
    counts = "/".join(str(sum(r["state"] == s for r in rows))
                      for s in ("reported", "bounded", "withheld"))
    told = [r for r in rows if "covered" in r and r["covered"] is not None]
    cover = f"{100 * sum(r['covered'] for r in told) / len(told):5.1f}" if told else "    -"
    if not given:
        print(f"{name:46} {len(rows):3} {cover} {'-':>7} {'-':>7} {'-':>7} {'-':>7} {counts:>10}")
        return
    errors = [r["error"] for r in given]
    spread = statistics.stdev(errors) if len(errors) > 1 else math.nan
    print(f"{name:46} {len(rows):3} {cover} {statistics.mean(r['errors'] for r in given):+7.2f} "
          f"{statistics.median(r['width'] for r in given):7.2f} {statistics.mean(errors):+7.2f} "
          f"{spread:7.2f} {counts:>10}")


def show_table(rows):
    print(f"{'condition':46} {'n':>3} cover  err/se   width    mean      sd  rep/bnd/wh")
    print(f"{'':46} {'':3}     %           points   error  points")
    for stated in ("nothing", "free", "panel"):
        for about, specimen in (("about 40", "S02"), ("0", "S01")):
            of = [r for r in rows if r["stated"] == stated and r["specimen"] == specimen]
            poor = [r for r in of if r["poor"]]
            if not of:
                continue
            name = f"{stated} stated, loss {about}"
            show_row(name, poor)
            for key, label in (("turn", "dyes {} degrees off"), ("stain", "counterstain: {}"),
                               ("file", "{}"), ("level", "{}"), ("scatter", "panels scatter {}")):
                for value in sorted({r[key] for r in poor}, key=str):
                    show_row("  " + label.format(value), [r for r in poor if r[key] == value])
            if len(poor) < len(of):
                show_row("  no tissue poor in collagen", [r for r in of if not r["poor"]])
    show_row("all", [r for r in rows if r["poor"]])


def colour(folder, args):
    results = pathlib.Path(args.results) if args.results else folder / "results.jsonl"
    rows = [json.loads(line) for line in results.read_text().splitlines()] \
        if results.exists() else []
    done = collections.Counter((r["number"], r["stated"]) for r in rows)

    def say(row):
        rows.append(row)
        with open(results, "a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def one(number):
        left = [how for how in args.stated if done[number, how] < 2]
        if left or not args.stated:
            work_set(args.bin, folder, number, left, args, say)

    at_once(args.threads, one, range(args.first, args.first + args.sets))
    rows = [r for r in rows if r["stated"] in args.stated]
    show_table(rows)
    for r in rows:
        if r["state"] != "reported" or not r["covered"]:
            given = "" if r["loss"] is None else f"{r['loss']:.1f} "
            ends = "" if r["upper"] is None else f"({r['lower']} to {r['upper']:.1f}) "
            print(f"set {r['number']} {r['specimen']}, {r['stated']} stated: {r['state']} {given}"
                  f"{ends}where {r['true']:.1f} is true. {r['reason'] or ''}")
    # Twice the ends of its interval is what chance brings to nobody.
    far = [r for r in rows if r["state"] == "reported" and abs(r["errors"]) > 2 * ENDS]
    return 1 if far else 0


# --- an operator's mistakes ---

# the variant, and words of which the sentence has to hold one
MISTAKES = (("label-on-its-head", ("label",)), ("order-wrong", ("order", "\"row\"", "snake")),
            ("y-up", ("y ",)), ("marker-um", ("marker_um", "markers_um")))


def mistakes(folder, args):
    def one(mistake):
        name, words = mistake
        place = Bench(args.bin, folder / name)
        wrong = json.loads((VARIANTS / f"{name}.json").read_text())
        block = {"block": {"like": "D", "sections": 36}}
        made = [place.phantom("S00", "L1", args.seed, args.px[0], block),
                place.phantom("S02", "L1", args.seed, args.px[0], {**block, **wrong})]
        refused = [place.call("import", folder, check=False) for folder in made][1]
        if "is no key" in refused:
            print(f"{name}: refused at import; named: {refused.splitlines()[0]}", flush=True)
            return any(w in refused for w in words)
        place.work()
        report, said = place.report("S02"), place.messages("S02")
        said += [report["verdict_reason"] or "", report["loss_reason"] or "", *report["warnings"]]
        named = next((s for s in said if any(w in s for w in words)), None)
        loss, truth = report["loss_percent"], true_loss(made[1])
        good = named is not None and (loss is None or abs(loss - truth) <= WRONG)
        given = "no loss" if loss is None else f"loss {loss:.1f}"
        print(f"{name}: {report['verdict']}, {given}, {truth:.1f} is true; "
              f"{'named: ' + named if named else 'not named: ' + (said[0] or 'nothing said')}"
              f"{'' if good else '   NOT MET'}", flush=True)
        return good

    return 0 if all(at_once(args.threads, one, MISTAKES)) else 1


# --- marks ---

# Eight sections, a panel of them, through the region.
FEW = {"like": "D", "sections": 8, "interval_um": 150, "lesion_um": [411, 646, 450]}


def mark_places(report, folder):
    """Visible marks, those found within a pixel, and those that were taken for marks elsewhere."""
    sections = {s["serial"]: s for s in report["sections"]}
    visible, found, wrong = 0, 0, 0
    for row in rows_of(folder, "markers.csv"):
        if row["visible"] != "1":
            continue
        visible += 1
        section = sections.get(int(row["k"]))
        at = section and section["state"] != "empty" and \
            section["markers_px"][int(row["marker"]) - 1]
        if not at or at[0] is None:
            continue
        off = math.hypot(at[0] - float(row["x_px"]), at[1] - float(row["y_px"]))
        found += off <= 1.0
        wrong += off > 3.0 and section["state"] in ("used", "doubtful")
    return visible, found, wrong


def one_panel(place, level, seed, px_um, of_marks, block=None):
    made = place.phantom("S00", level, seed, px_um,
                         {"block": block or FEW, "layout": [2, 4], "marks": of_marks})
    place.work(made)
    return made, place.report("S00")


def marks(folder, args):
    cases = [(px, radius, kind) for px in args.px for radius in args.radius
             for kind in ("disc", "hole") if radius / px >= 3]

    def one(case):
        px, radius, kind = case
        place = Bench(args.bin, folder / f"{px}-{radius}-{kind}")
        made, report = one_panel(place, "L1", args.seed, px, {"radius_um": radius, "kind": kind})
        visible, found, wrong = mark_places(report, made)
        reason = "" if found else "; ".join(place.messages("S00")[:1]) or report["verdict_reason"]
        print(f"{kind} of {radius:g} um at {px:g} um a pixel: {found} of {visible} found, {wrong} "
              f"wrong   {reason}", flush=True)
        shutil.rmtree(place.folder)
        return visible, found, wrong

    counts = at_once(args.threads, one, cases)
    visible, found, wrong = map(sum, zip(*counts))
    print(f"{found} of {visible} marks found, {100 * found / visible:.1f} %; {wrong} wrong")
    return 0 if found >= 0.98 * visible and wrong == 0 else 1


def decoys(folder, args):
    def one(case):
        px, count = case
        place = Bench(args.bin, folder / f"decoys-{px}-{count}")
        made, report = one_panel(place, "L1", args.seed, px, {"decoys": count})
        visible, found, _ = mark_places(report, made)
        truth = {int(r["k"]): r for r in rows_of(made, "sections.csv")}
        silent = [s["serial"] for s in report["sections"]
                  if s["state"] == "used" and pose_off(s, truth[s["serial"]]) > 100]
        flagged = sum(s["state"] in ("doubtful", "held") for s in report["sections"])
        print(f"{count} round spots a section at {px:g} um: {found} of {visible} marks found, {len(silent)} of "
              f"{len(report['sections'])} sections silently wrong, {flagged} doubtful or held",
              flush=True)
        return len(silent)

    cases = [(px, count) for px in args.px for count in args.decoys]
    return 1 if sum(at_once(args.threads, one, cases)) else 0


def pose_off(section, row):
    """How far a section's pose carries the middle of the block, and a point a millimetre beside it,
    from where they are, um."""
    m = section["panel_to_block_um"]
    if m is None:
        return 0.0
    t = [float(row[k]) for k in ("m00", "m01", "m02", "m10", "m11", "m12")]
    worst = 0.0
    for x, y in ((0, 0), (1000, 0), (0, 1000)):
        px, py = t[0] * x + t[1] * y + t[2], t[3] * x + t[4] * y + t[5]
        worst = max(worst, math.hypot(m[0] * px + m[1] * py + m[2] - x,
                                      m[3] * px + m[4] * py + m[5] - y))
    return worst


def unmarked(folder, args):
    """Three panels of eight sections each, with six round spots in each section and no mark."""
    total = 0
    for px in args.px:
        place = Bench(args.bin, folder / f"unmarked-{px}")
        _, report = one_panel(place, "L1", args.seed, px, {"none": True, "decoys": 6},
                              {**FEW, "sections": 24, "interval_um": 50})
        of = report["sections"]
        used = sum(at is not None and at[0] is not None for s in of for at in s["markers_px"]
                   if s["state"] in ("used", "doubtful"))
        offered = sum(bool(s["candidates"]) for s in of)
        print(f"{len(of)} sections without marks at {px:g} um a pixel: {used} marks used, {offered} "
              f"sections offered a pose; {report['verdict']}: {report['verdict_reason']}")
        total += used
    return 1 if total else 0


# Blocks whose region lies beside the middle of their marks, and how far 95 % of errors reach that
# are normal and alike in both directions, by their root mean square.
TRE_BLOCKS = ("geometry-07-slanting-root", "geometry-08-round-block", "geometry-09-square-block")
REACH_95 = math.sqrt(5.991 / 2)


def tre(folder, args):
    """Sections bend as at L2. Of each section that is used with its three marks the pose is held
    against the truth at points of the region 120 um apart."""
    def one(name):
        place = Bench(args.bin, folder / name)
        variant = json.loads((VARIANTS / f"{name}.json").read_text())
        made = place.phantom("S00", "L2", args.seed, args.px[0], variant)
        place.work(made)
        truth = registration.Truth(made / "truth")
        held = []
        for section in place.report("S00")["sections"]:
            k = section["serial"]
            if section["state"] != "used" or k not in truth.section or not truth.whole(k) or \
                    len(truth.visible(k)) < 3:
                continue
            where, predicted = registration.pose_map(section), section["predicted_tre_um"]
            off = [math.hypot(u - x, v - y) for x, y, px, py in truth.places(k)
                   for u, v in [where(px, py)]]
            held += [(distance, predicted) for distance in off]
        share = sum(distance <= REACH_95 * predicted for distance, predicted in held) / len(held)
        ratio = math.sqrt(sum(d * d for d, _ in held) / sum(p * p for _, p in held))
        print(f"{name}: of {len(held)} points {100 * share:.1f} % lie within the 95 % that are "
              f"predicted; errors are {ratio:.2f} of what is predicted", flush=True)
        return held

    held = [pair for pairs in at_once(args.threads, one, TRE_BLOCKS) for pair in pairs]
    share = sum(distance <= REACH_95 * predicted for distance, predicted in held) / len(held)
    print(f"together {100 * share:.1f} %")
    return 0 if 0.92 <= share <= 0.98 else 1


def frame(folder, args):
    """Processor time of the queue's work, the least of three runs of each."""
    least, used = {}, {}
    for wide in (0, 100):
        for turn in range(3):
            place = Bench(args.bin, folder / f"frame-{wide}-{turn}")
            made = place.phantom("S00", "L1", args.seed, args.px[0],
                                 {"block": FEW, "layout": [2, 4], "black_frame_px": wide})
            place.call("import", made)
            place.call("run", "--threads", 1, check=False)
            least[wide] = min(least.get(wide, math.inf), place.seconds)
        used[wide] = sum(s["state"] == "used" for s in place.report("S00")["sections"])
        print(f"frame of {wide} pixels: {least[wide]:.2f} s, {used[wide]} of 8 sections used; "
              f"{'; '.join(place.messages('S00'))}")
    print(f"a black frame costs {least[100] / least[0]:.2f} times as much")
    return 1 if least[100] > 1.3 * least[0] or used[100] < used[0] else 0


PARTS = {"colour": colour, "mistakes": mistakes, "marks": marks, "decoys": decoys,
         "unmarked": unmarked, "tre": tre, "frame": frame}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bin")
    parser.add_argument("what", choices=PARTS)
    parser.add_argument("--px", type=float, nargs="+", default=[24])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sets", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stated", nargs="*", choices=("nothing", "free", "panel"),
                        default=["nothing", "free", "panel"])
    parser.add_argument("--results")
    parser.add_argument("--radius", type=float, nargs="+", default=[20, 40, 75, 150, 300])
    parser.add_argument("--decoys", type=int, nargs="+", default=[0, 10, 20, 40, 60])
    parser.add_argument("--keep", help="a folder to work in and leave behind")
    args = parser.parse_args()
    if args.keep:
        return PARTS[args.what](pathlib.Path(args.keep), args)
    with tempfile.TemporaryDirectory(prefix="gieson-coverage-") as folder:
        return PARTS[args.what](pathlib.Path(folder), args)


if __name__ == "__main__":
    sys.exit(main())
