# SPDX-License-Identifier: AGPL-3.0-or-later
"""Compares study.json with what R makes of the same animals.csv."""
import csv
import io
import json
import pathlib
import subprocess

NAMES = ("kind", "group", "week", "against")


def differences(folder, script):
    """Sentences on what differs by more than a millionth, and how many comparisons there were."""
    folder = pathlib.Path(folder)
    told = subprocess.run(["Rscript", "--vanilla", script, str(folder / "animals.csv")],
                          capture_output=True, text=True, check=True).stdout
    study = json.loads((folder / "study.json").read_text())
    ours = {(c["kind"], c["group"], c["week"], c["against"]): c for c in study["comparisons"]
            if c["measure"] == "density" and c["p"] is not None}
    wrong = []
    rows = list(csv.DictReader(io.StringIO(told)))
    for row in rows:
        name = (row["kind"], row["group"], float(row["week"]), row["against"])
        comparison = ours.pop(name, None)
        if not comparison:
            wrong.append(f"R compares {name}, the study does not")
            continue
        for key in row.keys() - set(NAMES):
            if not row[key]:
                if comparison[key] is not None:
                    wrong.append(f"{name}, {key}: {comparison[key]}, R has none")
            elif abs(comparison[key] - float(row[key])) > 1e-6 * max(1, abs(float(row[key]))):
                wrong.append(f"{name}, {key}: {comparison[key]}, R says {row[key]}")
    wrong += [f"the study compares {name}, R does not" for name in ours]
    return wrong, len(rows)
