#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Several regions a specimen, from volumes of known densities to the study's table.

    regions.py BIN          one control and one treated animal
    regions.py BIN study    two of each, and the same region alone

Each half of a volume has its own density, and its own loss. A baseline without the region is named, and
what is no region is refused. Then: a named region says what a job says that has it for its only region,
and the study has a row an animal, region and measure. Each region is an analysis with its pictures, which
is seconds whatever the volume's size.
"""
import csv
import json
import os
import pathlib
import struct
import subprocess
import sys
import tempfile

NX, NY, NZ, STEP = 6, 4, 4, 24
# of the left and the right half: control animals, treated animals
DENSITY = {"c1": (0.60, 0.50), "c2": (0.62, 0.48), "t1": (0.45, 0.47), "t2": (0.42, 0.50)}
WALL = STEP * (NX / 2 - 0.5)
HALF = {"left": ([-12, -12, -12], [WALL, 180, 180]), "right": ([WALL, -12, -12], [276, 180, 180])}


def write_volume(path, left, right):
    cells = [left if x < NX // 2 else right for _ in range(NZ * NY) for x in range(NX)]
    head = (f"NRRD0004\ntype: float\ndimension: 3\nsizes: {NX} {NY} {NZ}\nendian: little\n"
            "encoding: raw\nspace dimension: 3\nspace units: \"um\" \"um\" \"um\"\n"
            f"space directions: ({STEP},0,0) (0,{STEP},0) (0,0,{STEP})\n\n")
    path.write_bytes(head.encode() + struct.pack(f"<{len(cells)}f", *cells))


def box(name):
    return {"shape": "box", "min": HALF[name][0], "max": HALF[name][1]}


def check(claim, sentence):
    if not claim:
        raise SystemExit(f"not true: {sentence}")


def holm(p):
    """Holm, 1979, by its definition."""
    order, least, out = sorted(range(len(p)), key=lambda i: p[i]), 0.0, [0.0] * len(p)
    for rank, i in enumerate(order):
        least = max(least, min(1.0, (len(p) - rank) * p[i]))
        out[i] = least
    return out


def check_alone(alone, named):
    check("regions" not in alone, "a job of one region says nothing of others")
    for key in ("loss_percent", "loss_interval", "loss_points", "baseline_mean_density"):
        check(alone[key] == named[key], f"{key} is {alone[key]} alone, {named[key]}")
    for key in ("mean_density", "volume_mm3", "coverage", "description"):
        check(alone["region"][key] == named[key], f"{key} is the same alone")


def check_study(studies, run):
    run("study", "halves")
    rows = list(csv.DictReader((studies / "animals.csv").open(newline="")))
    for name, side in (("left", 0), ("right", 1)):
        for animal, densities in DENSITY.items():
            row = [r for r in rows if (r["region"], r["animal"], r["measure"]) ==
                   (name, animal, "density")]
            check(len(row) == 1 and abs(float(row[0]["value"]) - densities[side]) < 2e-3,
                  f"one row for {animal}, {name}, density: {row}")
    study = json.loads((studies / "study.json").read_text())
    check([p["region"] for p in study["regions"]] == list(HALF), "study.json has both regions")
    losses = [c for part in [study, *study["regions"]] for c in part["comparisons"]
              if c["measure"] == "density" and c["kind"] == "against control"]
    check(len(losses) == 3, f"three losses: {len(losses)}")
    for c, p in zip(losses, holm([c["p"] for c in losses])):
        check(abs(c["p_holm"] - p) < 1e-8, f"Holm over all regions: {c['p_holm']}, {p}")
    check("Region left" in (studies / "index.html").read_text(), "and the page too")


def main():
    gieson = str(pathlib.Path(sys.argv[1]) / "gieson")
    has_study = sys.argv[2:] == ["study"]
    with tempfile.TemporaryDirectory(prefix="gieson-regions-") as place:
        folder = pathlib.Path(place)
        env = dict(os.environ, GIESON_STORE=str(folder / "store"))

        def run(*words, ends=0):
            done = subprocess.run([gieson, *map(str, words)], env=env, capture_output=True, text=True)
            check(done.returncode == ends, f"gieson {words} ends with {ends}: {done.returncode} "
                                           f"{done.stdout}{done.stderr}")
            return done.stdout + done.stderr

        def take(name, animal, regions, ends=0, **more):
            home = folder / name
            home.mkdir(exist_ok=True)
            write_volume(home / "v.nrrd", *DENSITY[animal])
            job = {"specimen": name, "animal": animal, "kind": "volume", "file": "v.nrrd", **more}
            if regions is not None:
                job["regions"] = regions
            (home / "job.json").write_text(json.dumps(job))
            return run("import", home, ends=ends)

        def report(name):
            return json.loads(run("report", name, "--json"))

        both = {name: box(name) for name in HALF}
        for animal in DENSITY if has_study else ("c1", "t1"):
            group = {"study": "halves", "group": "none"} if animal[0] == "c" else \
                {"study": "halves", "group": "drug", "baseline": "c1"}
            take(animal, animal, both if has_study or animal == "t1" else {"left": box("left")}, **group)
        if has_study:
            # The second of these regions as the only one of its job.
            take("alone-c1", "c1", None, region=box("right"))
            take("alone-t1", "t1", None, region=box("right"), baseline="alone-c1")
        run("run")

        regions = {r["name"]: r for r in report("t1")["regions"]}
        for side, name in enumerate(HALF if has_study else ("left",)):
            loss = regions[name]["loss_percent"]
            true = 100 * (1 - DENSITY["t1"][side] / DENSITY["c1"][side])
            check(abs(loss - true) < 0.2, f"{name}: loss {loss}, true {true}")
        if has_study:
            check_alone(report("alone-t1"), regions["right"])
        latest = folder / "store" / "reports" / "t1" / "latest"
        page = (latest / "report.html").read_text()
        for name in HALF:
            check(f'href="region-{name}.html"' in page, "the page leads to each region's own")
            inner = json.loads((latest / f"region-{name}.json").read_text())
            check(inner["specimen"] == f"t1, region {name}", "which says whose it is")
        check("region left: loss 25.0 %" in run("report", "t1"), "the text has a line a region")
        if has_study:
            run("verify", "t1")
            check_study(folder / "store" / "studies" / "halves", run)
            return 0
        lacking = regions["right"]
        check(lacking["loss_percent"] is None and
              'the baseline c1 has no region "right"' in lacking["withheld"],
              f"a baseline without the region is named: {lacking['withheld']}")
        check(any("region right: " in w for w in report("t1")["warnings"]), "and warned of")
        for wrong, said in (({"a b": box("left")}, "is no name of a region"),
                            ({f"r{i}": box("left") for i in range(9)}, "at most 8"),
                            ([box("left")], '"regions" must be'),
                            ({"left": {"shape": "box"}}, '"left" must be'),
                            ({"left": "nothing.mhd"}, "there is no such file")):
            check(said in take("wrong", "c1", wrong, ends=65), f"{wrong} is refused: {said}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
