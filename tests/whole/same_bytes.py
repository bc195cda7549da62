#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The net for whoever moves code: fresh imports through an old and a new build, every byte compared.

    same_bytes.py OLD_BIN NEW_BIN [--quick] [--plain] [--keep FOLDER]

Each material is made once, by the old build, then imported and run by both, each with a store of
its own; `gieson verify` is not asked, for it may use what a store kept. Compared are all files of a
run's folder (report.html, report.json, the volumes) and, of `gieson register`, the poses. Names of
folders hold the run's key, which knows the version of the program, so they are not compared; nor
is audit-RUN.json, which holds hashes of an audit log with times in it, nor the line of the
processor time that a registration took.

Materials: L0, L1, three seeds of L2, one L3, a volume, a tile, a folder of sections; --quick: L0 at
coarse pixels, a tile and a folder. --plain: the new build runs as on a processor without AVX and FMA,
as far as glibc, OpenCV and libjpeg-turbo can be told (our own kernels are compared in tests/model). A new material is a line in MATERIALS.
Exit 0: every byte is equal; 1: something differs, and which file, where first."""
import argparse
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

SHARED = pathlib.Path(__file__).resolve().parents[3] / "shared"

# name, what it is, arguments of its making
MATERIALS = [
    ("L0", "phantom", ["--level", "L0", "--seed", "1"]),
    ("L1", "phantom", ["--level", "L1", "--seed", "1"]),
    ("L2-7", "phantom", ["--level", "L2", "--seed", "7"]),
    ("L2-8", "phantom", ["--level", "L2", "--seed", "8"]),
    ("L2-9", "phantom", ["--level", "L2", "--seed", "9"]),
    ("L3", "phantom", ["--level", "L3", "--seed", "22"]),
    ("volume", "file", ["--volume", SHARED / "data/volumes/tooth.mhd", "--threshold", "100", "--spacing-unit", "um"]),
    ("tile", "file", ["--tile", SHARED / "data/colour/psr_left.jpg", "--specimen", "psr"]),
    ("folder", "folder", ["--n", "12", "--seed", "5"]),
]
PLAIN = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512DQ,-AVX2,-AVX2_Usable,"
                           "-AVX,-FMA,-FMA_Usable,-FMA4",
         "OPENCV_CPU_DISABLE": "AVX512_SKX,AVX2,FP16,AVX,FMA3", "JSIMD_FORCESSE2": "1"}
QUICK = [("L0", "phantom", ["--level", "L0", "--seed", "1", "--px", "32"]), *MATERIALS[-2:]]


def run(*command, allowed=(0,)):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode not in allowed:
        raise SystemExit(f"{' '.join(map(str, command))}\nended with {done.returncode}\n"
                         f"{done.stdout}{done.stderr}")
    return done.stdout


def make(kind, arguments, old, folder):
    """The material on disk; None: its source is not on this machine."""
    if kind == "phantom":
        for specimen in ("S00", "S02"):
            run(old / "gieson-phantom", "--specimen", specimen, *arguments,
                "--out", folder / f"GVP-D-{specimen}")
        return folder
    if kind == "file":
        return folder if pathlib.Path(arguments[1]).exists() else None
    generator = SHARED / "peers/gen/gen_sections.py"
    if not generator.exists():
        return None
    run("/usr/bin/python3", generator, folder, *arguments)
    return folder


def answer(kind, arguments, programs, material, place):
    """Runs one build over a material; the bytes of all that it wrote, by name."""
    gieson = [programs / "gieson", "--store", place / "store"]

    if kind == "folder":
        poses = run(programs / "gieson", "--json", "register", material, allowed=(0, 65))
        return {"poses": "".join(line for line in poses.splitlines(keepends=True)
                                 if "cpu_ms" not in line).encode()}
    if kind == "phantom":
        for scans in sorted(material.iterdir()):
            run(*gieson, "import", scans)
    else:
        run(*gieson, "import", *arguments)
    run(*gieson, "run", allowed=(0, 65))
    reports = place / "store" / "reports"
    return {f"{path.relative_to(reports).parts[0]}/{path.name}": path.read_bytes()
            for path in sorted(reports.rglob("*"))
            if path.is_file() and not path.name.startswith("audit-")}


def first_difference(a, b):
    at = next((i for i, (x, y) in enumerate(zip(a, b)) if x != y), min(len(a), len(b)))
    return f"{len(a)} and {len(b)} bytes, first differ at {at}: " \
           f"{a[max(at - 30, 0):at + 30]!r} | {b[max(at - 30, 0):at + 30]!r}"


def compare(name, old, new):
    """Prints what differs; the number of files that do."""
    differ = 0
    for file in sorted(old.keys() | new.keys()):
        if file not in old or file not in new:
            print(f"{name}: {file}: only the {'old' if file in old else 'new'} build writes it")
        elif old[file] != new[file]:
            print(f"{name}: {file}: {first_difference(old[file], new[file])}")
        else:
            continue
        differ += 1
    print(f"{name}: {len(old)} files, {sum(map(len, old.values()))} bytes, {differ} differ",
          flush=True)
    return differ + (not old)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("old", type=pathlib.Path)
    parser.add_argument("new", type=pathlib.Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--keep", type=pathlib.Path, help="work here and leave it behind")
    args = parser.parse_args()
    home = args.keep or pathlib.Path(tempfile.mkdtemp(prefix="gieson-same-"))
    differ = skipped = 0
    for name, kind, arguments in QUICK if args.quick else MATERIALS:
        material = home / name / "material"
        material.mkdir(parents=True)
        if make(kind, arguments, args.old.resolve(), material) is None:
            print(f"{name}: skipped, its source is not on this machine")
            skipped += 1
            continue
        seen = []
        for build in ("old", "new"):
            place = home / name / build
            place.mkdir()
            if args.plain and build == "new":
                os.environ.update(PLAIN)
            seen.append(answer(kind, arguments, getattr(args, build).resolve(), material, place))
            for variable in PLAIN:
                os.environ.pop(variable, None)
        differ += compare(name, *seen)
        if not args.keep:
            shutil.rmtree(home / name)
    print(f"{'equal' if differ == 0 else 'DIFFERENT'}: {differ} files differ, {skipped} materials "
          "skipped")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
