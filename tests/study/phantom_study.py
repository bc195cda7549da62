#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""A study of drawn animals from their panels to one page: what the page says against the truth.

    phantom_study.py BIN study.R [--seed 27] [--keep DIR]     ends with 77 where R is not installed

Three groups of four animals (N, the controls, S and U), one animal each after two, four and eight
weeks (T), and four that were treated with nothing and lost nothing (null), at level L1, each with
its calibration panel. After the import one command makes everything: `gieson night`.
"""
import argparse
import csv
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import compare_r

GROUPS = {"N": 4, "S": 4, "U": 4}
WEEKS = {"T2": 2, "T4": 4, "T8": 8}
NULL = ("S1", "S2", "S3", "S4")
WITHIN = 0.5  # points of a group's loss


class Check:
    """Counts what is not true, and says it."""

    def __init__(self):
        self.failed = 0

    def __call__(self, claim, sentence):
        if not claim:
            print("not true:", sentence, flush=True)
            self.failed += 1


def make_animals(phantom, folder, seed):
    """gives: animal -> the share of the block's collagen that it holds."""
    (folder / "calibrated.json").write_text('{"calibration": true}')
    (folder / "null.json").write_text('{"calibration": true, "loss": 0, "label": "none"}')
    left = {}

    def make(specimen, variant, name):
        out = folder / name
        subprocess.run([str(phantom), "--specimen", specimen, "--level", "L1", "--seed", str(seed),
                        "--px", "24", "--variant", str(folder / variant), "--out", str(out)],
                       check=True)
        row = next(csv.DictReader((out / "truth" / "loss.csv").read_text().splitlines()))
        left[name] = 1 - float(row["loss_pct"]) / 100
        return out

    for group, animals in GROUPS.items():
        for i in range(1, animals + 1):
            make(f"{group}{i}", "calibrated.json", f"GVP-D-{group}{i}")
    for specimen in WEEKS:
        make(specimen, "calibrated.json", f"GVP-D-{specimen}")
    for i, specimen in enumerate(NULL):
        out = make(specimen, "null.json", f"null-{i + 1}")
        job = json.loads((out / "job.json").read_text())
        job.update(specimen=out.name, group="null", animal=out.name)
        (out / "job.json").write_text(json.dumps(job))
    return left


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def find(study, kind, group, week, against="N"):
    return next(c for c in study["comparisons"]
                if (c["kind"], c["measure"], c["group"], c["week"], c["against"]) ==
                (kind, "density", group, week, against))


def check_losses(study, left, check):
    """Each group's loss against the truth of the animals that take part."""
    control = mean(v for name, v in left.items() if name.startswith("GVP-D-N"))
    taking_part = {s["animal"]: s["specimen"] for s in study["specimens"] if not s["left_out"]}

    for c in study["comparisons"]:
        if c["kind"] != "against control" or c["measure"] != "density":
            continue
        own = [left[taking_part[a["animal"]]] for a in study["animals"]
               if (a["group"], a["week"]) == (c["group"], c["week"])]
        true = 100 * (1 - mean(own) / control)
        error = c["loss_percent"] - true
        interval = "no interval" if c["loss_lower"] is None else \
            f"{c['loss_lower']:.2f} to {c['loss_upper']:.2f}, p {c['p']:.2g}, Holm {c['p_holm']:.2g}"
        print(f"{c['group']:>4}, week {c['week']:.0f}: n {len(own)}, loss {c['loss_percent']:.2f} % "
              f"({interval}), true {true:.2f}, error {error:+.2f} points", flush=True)
        check(abs(error) <= WITHIN, f"the loss of {c['group']}, week {c['week']} is within "
                                    f"{WITHIN} points of the truth")
        budget = c["variance_of_loss"]
        parts = [v for k, v in budget.items() if k != "total"]
        if budget["total"] is not None:
            print("      variance, points^2: " + ", ".join(
                f"{k} {v:.3g}" for k, v in budget.items() if v is not None), flush=True)
            check(abs(sum(v for v in parts if v is not None) / budget["total"] - 1) <= 0.05,
                  f"the variance budget of {c['group']} adds up")


def check_few(run, page, check):
    """One, two and three animals, each with its sentence."""
    said = run("study", "GVP-D")
    check("a single animal has no spread" in said, "one animal: no interval, and why")
    for last, n, least in (("GVP-D-S4", 3, "0.057"), ("GVP-D-S3", 2, "0.13")):
        run("study", "GVP-D", "exclude", last, "--because", "to see what fewer allow")
        said = run("study", "GVP-D")
        line = next(row for row in said.splitlines() if "loss of S" in row)
        print(f"  {line.strip()}", flush=True)
        check(f"with {n} against 4 animals no permutation or rank test can reach 0.05: the "
              f"smallest p it can give is {least}" in line, f"{n} animals are told what they allow")
        check("excluded by" in (page / "index.html").read_text(), "the page says who was excluded")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("script")
    parser.add_argument("--seed", type=int, default=27)
    parser.add_argument("--keep", type=pathlib.Path, help="an empty folder for the store")
    args = parser.parse_args()
    if not shutil.which("Rscript"):
        print("skipped: R is not installed (r-base-core)")
        return 77
    check = Check()
    with tempfile.TemporaryDirectory(prefix="gieson-study-") as place:
        folder = args.keep or pathlib.Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        store = folder / "store"
        env = dict(os.environ, GIESON_STORE=str(store))

        def run(*words, ends=0):
            done = subprocess.run([str(args.bin / "gieson"), *map(str, words)], env=env,
                                  capture_output=True, text=True)
            if done.returncode != ends:
                raise SystemExit(f"gieson {words} ended with {done.returncode}\n{done.stdout}"
                                 f"{done.stderr}")
            return done.stdout + done.stderr

        left = make_animals(args.bin / "gieson-phantom", folder, args.seed)
        for name in left:
            run("import", folder / name)
        run("night")
        page = store / "studies" / "GVP-D"
        study = json.loads((page / "study.json").read_text())

        check(all(s["left_out"] is None for s in study["specimens"]), "all specimens take part")
        check_losses(study, left, check)
        null = find(study, "against control", "null", 8)
        check(null["p"] > 0.05 and null["p_permutation"] > 0.05 and
              null["loss_lower"] < 0 < null["loss_upper"], "what nobody treated lost nothing")
        between = find(study, "between groups", "S", 8, "U")
        print(f"S against U: p {between['p']:.2g}, permutation {between['p_permutation']:.2g}")
        check(between["p"] < 0.01, "the two treatments differ")
        wrong, compared = compare_r.differences(page, args.script)
        check(not wrong, "; ".join(wrong))
        print(f"{compared} comparisons as R has them", flush=True)
        check_few(run, page, check)
    return 1 if check.failed else 0


if __name__ == "__main__":
    sys.exit(main())
