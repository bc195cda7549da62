#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""A study from volumes of known densities to its page, and the same comparisons by R.

    study_whole.py BIN study.R     ends with 77 where R is not installed
"""
import csv
import json
import os
import pathlib
import random
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import urllib.parse

import compare_r

SIDE = 8
GROUPS = {"placebo": 0.60, "drug A": 0.50, "drug B": 0.38}
WEEKS = (1, 4)
ANIMALS = 3


def write_volume(path, mean):
    """A cube whose density rises evenly along its diagonal: its mean is exact."""
    cells = [mean * (0.95 + 0.1 * (x + y + z) / (3 * (SIDE - 1)))
             for z in range(SIDE) for y in range(SIDE) for x in range(SIDE)]
    head = (f"NRRD0004\ntype: float\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nendian: little\n"
            "encoding: raw\nspace dimension: 3\nspace units: \"um\" \"um\" \"um\"\n"
            "space directions: (24,0,0) (0,24,0) (0,0,24)\n\n")
    path.write_bytes(head.encode() + struct.pack(f"<{len(cells)}f", *cells))


def check(claim, sentence):
    if not claim:
        print("not true:", sentence)
        sys.exit(1)


def check_links(page, least):
    """Each link of the page leads to a file beside it."""
    links = re.findall(r'href="([^"#]+)"', page.read_text())
    check(len(links) >= least, f"{page}: {len(links)} links")
    for link in links:
        there = page.parent / urllib.parse.unquote(link)
        check(there.is_file(), f"{page}: {link} leads nowhere")


def main():
    bin_dir, script = sys.argv[1:3]
    if not shutil.which("Rscript"):
        print("skipped: R is not installed (r-base-core)")
        return 77
    gieson = str(pathlib.Path(bin_dir) / "gieson")
    with tempfile.TemporaryDirectory(prefix="gieson-study-") as folder:
        folder = pathlib.Path(folder)
        env = dict(os.environ, GIESON_STORE=str(folder / "store"))

        def run(*args, ends=0):
            done = subprocess.run([gieson, *args], env=env, capture_output=True, text=True)
            check(done.returncode == ends, f"gieson {args} ends with {ends}: {done.returncode} "
                                           f"{done.stdout}{done.stderr}")
            return done.stdout + done.stderr

        draw = random.Random(11)
        truth = {}
        for group, mean in GROUPS.items():
            for week in WEEKS:
                for animal in range(ANIMALS):
                    name = f"{group.replace(' ', '')}-{week}-{animal}"
                    home = folder / "in" / name
                    home.mkdir(parents=True)
                    rat = f"rat {len(truth) + 1}"
                    truth[rat] = draw.gauss(mean, 0.03)
                    write_volume(home / "v.nrrd", truth[rat])
                    job = {"specimen": name, "study": "drawn", "group": group, "animal": rat,
                           "week": week, "kind": "volume", "file": "v.nrrd"}
                    if group != "placebo":
                        job["baseline"] = "placebo"
                    (home / "job.json").write_text(json.dumps(job))
                    run("import", str(home))
        run("run")
        run("study", "drawn")
        page = folder / "store" / "studies" / "drawn"
        first = {p.name: p.read_bytes() for p in page.iterdir()}
        check(set(first) == {"index.html", "study.json", "animals.csv", "loss-cells.csv"},
              f"four files: {first.keys()}")
        run("study")
        check(first == {p.name: p.read_bytes() for p in page.iterdir()}, "the same bytes again")

        shutil.rmtree(page)
        run("night")
        check(first == {p.name: p.read_bytes() for p in page.iterdir()}, "the night makes them too")

        # The front page, the last report of each, and a copy of all pages whose links hold.
        store = folder / "store"
        front = (store / "index.html").read_text()
        check("18</b> specimens" in front and front.count("<tr>") == 19, "a row a specimen")
        latest = store / "reports" / "drugA-1-0" / "latest"
        check((latest / "report.html").exists(), "the last report of a specimen")
        web = folder / "web"
        web.mkdir()
        run("index", "--publish", str(web))
        check_links(web / "index.html", 19)
        check((web / "reports/drugA-1-0/latest/report.html").read_text().count(
            f"../{latest.resolve().name}/report.html") == 2, "the last report is found there too")
        check_links(web / "studies" / "drawn" / "index.html", 18)
        check((web / "index.html").read_text() == front, "the page is the same there")
        check("no run of the store" not in run("scrub", "--quick"), "a link is no stray report")

        study = json.loads(first["study.json"])
        for animal in study["animals"]:
            value = animal["measures"]["density"]["value"]
            check(abs(value - truth[animal["animal"]]) < 2e-3,
                  f"{animal['animal']}: {value}, true {truth[animal['animal']]}")

        # Each animal's density is one pattern times its mean: each cell has the study's own loss.
        losses = {(c["group"], c["week"]): c for c in study["comparisons"]
                  if c["kind"] == "against control" and c["measure"] == "density"}
        cells = list(csv.DictReader(first["loss-cells.csv"].decode().splitlines()))
        check(len(cells) == 4 * 6, f"six cells of one cube in four comparisons: {len(cells)}")
        for cell in cells:
            whole = losses[cell["group"], float(cell["week"])]
            check((cell["animals"], cell["animals_against"]) == ("3", "3"), f"animals of {cell}")
            for name in ("loss_percent", "loss_lower", "loss_upper"):
                check(abs(float(cell[name]) - whole[name]) < 0.05, f"{name} of {cell}: {whole[name]}")
            check(abs(float(cell["p"]) / whole["p"] - 1) < 0.02, f"p of {cell}: {whole['p']}")
            check(abs(float(cell["q"]) / whole["p"] - 1) < 0.02, "q of six cells that are alike")
        check([m["cells"] for m in study["loss_maps"]] == [6] * 4, f"{study['loss_maps']}")
        check(first["index.html"].count(b"<polygon") == 4 * 6, "each cell is drawn")

        # R, from the CSV alone.
        wrong, compared = compare_r.differences(page, script)
        check(not wrong, "; ".join(wrong))
        check(compared == 6, f"four losses and two differences of treatments: {compared}")

        # Who takes part, blind and frozen.
        home = folder / "in" / "late"
        home.mkdir()
        write_volume(home / "v.nrrd", 0.5)
        (home / "job.json").write_text(json.dumps(
            {"specimen": "late", "study": "drawn", "group": "drug A", "animal": "rat 99", "week": 1,
             "kind": "volume", "file": "v.nrrd", "baseline": "sham"}))
        run("import", str(home))
        run("run")
        check("left out: late: withheld: the baseline sham" in run("study", "drawn"),
              "a specimen without a figure is named with its reason")
        run("study", "drawn", "exclude", "drugA-1-0", ends=65)
        check("excluded by" in run("study", "drawn", "exclude", "drugA-1-0", "--because", "broke"),
              "an exclusion is shown")
        run("study", "drawn", "unblind", ends=65)
        blind = run("study", "drawn", "blind")
        text = "".join(file.read_text() for file in page.iterdir())
        check(not any(word in blind + text for word in ("placebo", "sham", "drug")),
              "no name of a group while it is blind")
        run("index")
        front = (store / "index.html").read_text()
        check(not any(word in front for word in ("placebo", "sham", "drug")),
              "nor on the front page")
        run("study", "drawn", "freeze")
        run("study", "drawn", "include", "drugA-1-0", ends=65)
        check("placebo" in run("study", "drawn", "unblind"), "names are back")
        check("SD" not in run("study", "nobody", ends=66), "an unknown study is refused")

        # Planning, against power.t.test of R.
        plan = json.loads(run("plan", "--difference", "10", "--sd", "6", "--json"))
        said = subprocess.run(["Rscript", "--vanilla", "-e",
                               "cat(ceiling(power.t.test(delta=10, sd=6, power=.8)$n))"],
                              capture_output=True, text=True, check=True).stdout
        check(plan["animals_per_group"] == int(said), f"{plan}, R says {said}")
    print(f"{len(truth)} animals, {compared} comparisons as R has them")
    return 0


if __name__ == "__main__":
    sys.exit(main())
