#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Volumes that nobody would draw, from import to report.

    volumes.py BIN

Each file of volumes/ is a case: "of" says what it is; "size" in voxels, "spacing_um" (20 each way);
"fill" is the value everywhere, "ball" that within a third of the longest side of the middle; a run
"ends" as one word of `gieson status`, with the "sentence" that is said of it, and with the "mean" of
the region. No case may end a program by a signal.
"""
import json
import pathlib
import struct
import subprocess
import sys
import tempfile

CASES = pathlib.Path(__file__).resolve().parent / "volumes"


def write(folder, case):
    size, spacing = case["size"], case.get("spacing_um", [20, 20, 20])
    fill, ball = float(case["fill"]), float(case.get("ball", case["fill"]))

    def at(*place):
        apart = sum((p - (n - 1) / 2) ** 2 for p, n in zip(place, size))
        return ball if apart <= (max(size) / 3) ** 2 else fill

    values = [at(x, y, z) for z in range(size[2]) for y in range(size[1]) for x in range(size[0])]
    (folder / "v.mhd").write_bytes(
        "ObjectType = Image\nNDims = 3\nDimSize = {} {} {}\nElementSpacing = {} {} {}\n"
        "ElementType = MET_FLOAT\nElementDataFile = LOCAL\n".format(*size, *spacing).encode()
        + struct.pack(f"<{len(values)}f", *values))
    (folder / "job.json").write_text(json.dumps({"specimen": case["name"], "kind": "volume",
                                                 "file": "v.mhd", "spacing_unit": "um"}))


def main(programs):
    failed = 0
    cases = [{"name": file.stem, **json.loads(file.read_text())}
             for file in sorted(CASES.glob("*.json"))]
    with tempfile.TemporaryDirectory(prefix="gieson-volumes-") as place:
        folder = pathlib.Path(place)

        def call(*args):
            return subprocess.run([programs / "gieson", "--store", folder / "store", *args],
                                  capture_output=True, text=True, check=False)

        for case in cases:
            (folder / case["name"]).mkdir()
            write(folder / case["name"], case)
            done = call("import", folder / case["name"])
            assert done.returncode == 0, done.stderr
        run = call("run")
        print(run.stdout, run.stderr)
        status = {s["specimen"]: s for s in json.loads(call("status", "--json").stdout)["specimens"]}
        for case in cases:
            said = status[case["name"]]
            wrong = []
            if said["state"] != case["ends"]:
                wrong.append(f"is {said['state']}, {case['ends']} was expected")
            if case.get("sentence", "") not in said["detail"] + run.stdout + run.stderr:
                wrong.append(f"nothing says \"{case['sentence']}\"")
            if "mean" in case and abs(said["mean_density"] - case["mean"]) > 1e-6 * abs(case["mean"]):
                wrong.append(f"its mean is {said['mean_density']}")
            print(f"{case['name']}, {case['of']}: {'; '.join(wrong) or 'as expected'} "
                  f"({said['detail']})")
            failed += bool(wrong)
    return 1 if failed or not cases else 0


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1])))
