#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Several regions a specimen, from volumes of known densities to the study's table.

    regions.py BIN

Each half of a volume has its own density, and its own loss. A named region says what a job says that
has it for its only region; the study has a row an animal, region and measure; a baseline without the
region is named.
"""
import csv
import json
import os
import pathlib
import struct
import subprocess
import sys
import tempfile

NX, NY, NZ, STEP = 12, 8, 8, 24
# of the left and the right half: control animals, treated animals
DENSITY = {"c1": (0.60, 0.50), "c2": (0.62, 0.48), "t1": (0.45, 0.47), "t2": (0.42, 0.50)}
HALF = {"left": ([-12, -12, -12], [132, 180, 180]), "right": ([132, -12, -12], [276, 180, 180])}


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


def main():
    gieson = str(pathlib.Path(sys.argv[1]) / "gieson")
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
        for animal in DENSITY:
            group = {"study": "halves", "group": "none"} if animal[0] == "c" else \
                {"study": "halves", "group": "drug", "baseline": "none"}
            take(animal, animal, both, **group)
        # The same regions, each the only one of its job.
        for name in HALF:
            take(f"alone-{name}-c1", "c1", None, region=box(name), group=f"alone-{name}")
            take(f"alone-{name}-t1", "t1", None, region=box(name), baseline=f"alone-{name}-c1")
        take("pair", "t1", both, baseline="c1")
        take("lacking", "t1", {"middle": box("left")}, baseline="c1")
        run("run")

        for name in HALF:
            alone, named = report(f"alone-{name}-t1"), \
                next(r for r in report("pair")["regions"] if r["name"] == name)
            check("regions" not in alone, "a job of one region says nothing of others")
            for key in ("loss_percent", "loss_interval", "loss_points", "baseline_mean_density"):
                check(alone[key] == named[key], f"{name}: {key} is {alone[key]} alone, {named[key]}")
            for key in ("mean_density", "volume_mm3", "coverage", "description"):
                check(alone["region"][key] == named[key], f"{name}: {key} is the same alone")
            side = list(HALF).index(name)
            true = 100 * (1 - DENSITY["t1"][side] / DENSITY["c1"][side])
            check(abs(named["loss_percent"] - true) < 0.2, f"{name}: loss {named['loss_percent']}, "
                                                           f"true {true}")
        latest = folder / "store" / "reports" / "pair" / "latest"
        page = (latest / "report.html").read_text()
        for name in HALF:
            check(f'href="region-{name}.html"' in page, "the page leads to each region's own")
            inner = json.loads((latest / f"region-{name}.json").read_text())
            check(inner["specimen"] == f"pair, region {name}", "which says whose it is")
        check("region left: loss 25.0 %" in run("report", "pair"), "the text has a line a region")
        run("verify", "pair")

        lacking = report("lacking")["regions"][0]
        check(lacking["loss_percent"] is None and
              'the baseline c1 has no region "middle"' in lacking["withheld"],
              f"a baseline without the region is named: {lacking['withheld']}")
        check(any("region middle: " in w for w in report("lacking")["warnings"]), "and warned of")

        run("study", "halves")
        studies = folder / "store" / "studies" / "halves"
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

        for wrong, said in (({"a b": box("left")}, "is no name of a region"),
                            ({f"r{i}": box("left") for i in range(9)}, "at most 8"),
                            ([box("left")], '"regions" must be'),
                            ({"left": {"shape": "box"}}, '"left" must be'),
                            ({"left": "nothing.mhd"}, "there is no such file")):
            check(said in take("wrong", "c1", wrong, ends=65), f"{wrong} is refused: {said}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
