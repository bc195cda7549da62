#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Does what the README and the user's manual say.

    test_readme.py BIN             BIN is the folder with the programs
    test_readme.py BIN tutorial    the tutorial alone, from its first line to its last

- The set-up is exactly two commands, `./run demo` and `./run test`, and they are all of their block.
- Every `gieson ...` line of a block marked "sh example" ends with 0, in the order of the page, in an
  empty folder with BIN first in PATH; `export NAME=VALUE` holds for the lines behind it.
- Every other program named in an "sh" block is one of ours in BIN, one of the repository's, or one
  that the build itself uses; every verb named anywhere in the page is one that --help lists.
- Every "json" block is a job.json that `gieson import` takes, every "ini" block a configuration with
  which `gieson check-config` finds no fault.
- The same holds for the pages of docs/user, for the indented pieces of a job in job.md, and verbs named
  in any page of docs are verbs.
- The indented commands of docs/user/register.md register a folder of drawn sections.
- What `gieson export` prints of a stack is what its OME-TIFF says of itself.
- The examples of docs/user/model.md and reference.md, which ask the specimen of the README's, are typed
  behind them. Blocks marked "sh tutorial" are typed in a folder of their own.
"""
import itertools
import json
import math
import os
import pathlib
import random
import re
import shlex
import struct
import subprocess
import sys
import tempfile
import zlib

ROOT = pathlib.Path(__file__).resolve().parents[2]
SETUP = ["./run demo", "./run test"]
OF_THE_BUILD = {"cmake", "ctest"}
OF_DEBIAN = {"dpkg-buildpackage", "apt"}  # tests/package types these
TYPED = {"example": ("gieson", "export"), "tutorial": ("gieson", "export", "echo")}
FENCE = re.compile(r"^```(\w*)[ ]*(\w*)[ ]*\n(.*?)^```[ ]*$", re.S | re.M)
EXPORT = re.compile(r"^export (\w+)=(\S+)$")
LINE_LIMIT_S = 600


def blocks(page):
    """(language, mark, lines) of every fenced block."""
    found = []
    for language, mark, text in FENCE.findall(page):
        lines = [line.strip() for line in text.replace("\\\n", " ").splitlines()]
        found.append((language, mark, [line for line in lines if line and line[0] != "#"]))
    return found


def check_setup(found, say):
    holding = [lines for language, _, lines in found
               if language == "sh" and any(line.startswith("./run") for line in lines)]
    if holding != [SETUP]:
        say(f"the set-up must be one block of {SETUP}, not {holding}")


def check_programs(found, bin_folder, say):
    for language, mark, lines in found:
        for line in lines if language == "sh" else []:
            program = shlex.split(line)[0]
            known = program in TYPED["tutorial"] or program in OF_THE_BUILD | OF_DEBIAN or \
                (program.startswith("./") and os.access(ROOT / program, os.X_OK)) or \
                os.access(bin_folder / program, os.X_OK)
            if not known:
                say(f"`{line}`: {program} is not a program of ours")
            if mark in TYPED and program not in TYPED[mark]:
                say(f"`{line}`: an example is typed by this test, which knows only {TYPED[mark]}")


def check_verbs(page, help_text, say):
    typed = "\n".join(line for language, _, lines in blocks(page) if language == "sh" for line in lines)
    for verb in sorted(set(re.findall(r"`gieson ([a-z]\w*)", page)) |
                       set(re.findall(r"^gieson ([a-z]\w*)", typed, re.M))):
        if not re.search(rf"^\s+{verb}\b", help_text, re.M):
            say(f"`gieson {verb}` is not a verb that --help lists")


def ended(command, folder):
    return subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          errors="replace", timeout=LINE_LIMIT_S)


def import_job(job, bin_folder, where, say):
    """A job is taken by an import, with whatever files it names."""
    with tempfile.TemporaryDirectory(prefix="gieson-job-") as folder:
        scans = pathlib.Path(folder) / "scans"
        scans.mkdir()
        (scans / "job.json").write_text(json.dumps(job))
        for name in re.findall(r'"([^"]+\.(?:tif|png|mhd|nrrd))"', json.dumps(job)):
            (scans / name).write_bytes(b"any")
        for name in re.findall(r'"([^"]+\.geojson)"', json.dumps(job)):
            (scans / name).write_text(json.dumps(draw_outline(job["region"]["class"])))
        done = ended([bin_folder / "gieson", "-s", "store", "import", "scans"], folder)
        if done.returncode != 0:
            say(f"{where}: the job {json.dumps(job)[:80]}... is not taken: {done.stderr.strip()}")


def draw_outline(name):
    """A square on the second section, as QuPath writes it."""
    return {"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": {"classification": {"name": name}}, "geometry": {
            "type": "Polygon", "plane": {"c": -1, "z": 1, "t": 0},
            "coordinates": [[[5, 5], [60, 5], [60, 60], [5, 60], [5, 5]]]}}]}


def check_json(found, bin_folder, say):
    for language, _, lines in found:
        if language != "json":
            continue
        try:
            import_job(json.loads("\n".join(lines)), bin_folder, "README.md", say)
        except ValueError as reason:
            say(f"a json block does not parse: {reason}")


def check_ini(page, bin_folder, say):
    for language, _, text in FENCE.findall(page):
        if language != "ini":
            continue
        with tempfile.NamedTemporaryFile("w", suffix=".conf") as file:
            file.write(text)
            file.flush()
            done = ended([bin_folder / "gieson", "check-config", file.name], ".")
            if done.returncode != 0:
                say(f"an ini block is refused: {done.stderr.strip()}")


def pieces(text):
    """Indented blocks that are JSON, whole or keys of an object: a list of objects each."""
    for block in re.findall(r"(?:^    .*\n)+", text, re.M):
        if block.lstrip()[0] not in '{"':
            continue
        # A name in place of a number stands for one, a later for a larger one.
        count = itertools.count(100, 100)
        rest = re.sub(r"(?<=[\[ ])(?:[xyzr]|from|to)(?=[,\]}])", lambda _: str(next(count)), block.strip())
        decoder = json.JSONDecoder()
        if rest[0] == '"':
            yield json.loads("{" + rest + "}")
            continue
        while rest:
            piece, end = decoder.raw_decode(rest)
            rest = rest[end:].strip()
            yield {"region": piece}


def check_docs(bin_folder, help_text, say):
    frame = {"specimen": "Q", "markers_um": [[-2050, -1000], [1700, -1500], [-1500, 1300]]}
    count = 0
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        check_verbs(text, help_text, say)
        check_programs(blocks(text), bin_folder, say)
        check_ini(text, bin_folder, say)
    for piece in pieces((ROOT / "docs/user/job.md").read_text(encoding="utf-8")):
        import_job({**frame, **piece}, bin_folder, "docs/user/job.md", say)
        count += 1
    if count < 5:
        say(f"docs/user/job.md: only {count} pieces of a job were found")


def write_png(path, size, pixel):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + bytes(pixel(x, y) for x in range(size)) for y in range(size))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" +
                     chunk(b"IHDR", struct.pack(">IIBBBBB", size, size, 8, 0, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def draw_sections(folder, count=6, size=320):
    """A disc of tissue with three burns, each section turned and moved a little."""
    dice = random.Random(5)
    for number in range(count):
        turn, at = dice.uniform(-0.3, 0.3), [size / 2 + dice.uniform(-8, 8) for _ in range(2)]
        marks = [(at[0] + math.cos(turn) * x - math.sin(turn) * y,
                  at[1] + math.sin(turn) * x + math.cos(turn) * y)
                 for x, y in ((-90, -30), (75, -60), (20, 85))]

        def pixel(x, y):
            if math.hypot(x - at[0], y - at[1]) > 140:
                return 240 + dice.randrange(5)
            burn = min(math.hypot(x - u, y - v) for u, v in marks)
            return int(40 + 120 * min(max(burn - 9.5, 0), 1)) + dice.randrange(9)
        write_png(folder / f"slice_{number:04}.png", size, pixel)


def type_register(bin_folder, say):
    """The commands that docs/user/register.md begins with, on a folder of drawn sections."""
    page = (ROOT / "docs/user/register.md").read_text(encoding="utf-8")
    lines = [re.split(r"  +", line)[0] for line in re.findall(r"^    (gieson .*)$", page, re.M)]
    environment = {**os.environ, "PATH": f"{bin_folder}{os.pathsep}{os.environ.get('PATH', '')}"}
    if len(lines) < 2:
        say("docs/user/register.md: its commands were not found")
    with tempfile.TemporaryDirectory(prefix="gieson-register-") as name:
        folder = pathlib.Path(name)
        (folder / "FOLDER").mkdir()
        draw_sections(folder / "FOLDER")
        for line in lines:
            done = subprocess.run(["sh", "-c", line], cwd=folder, env=environment, capture_output=True,
                                  text=True, timeout=LINE_LIMIT_S)
            if done.returncode != 0:
                say(f"docs/user/register.md: `{line}` ended with {done.returncode}: {done.stderr}")
        told = json.loads((folder / "poses.json").read_text(encoding="utf-8"))
        laid = [name for name in told if name.startswith("slice_") and len(told[name]) == 2]
        if len(laid) != 6 or told["gieson"]["sections"] != 6:
            say(f"docs/user/register.md: of 6 sections {len(laid)} have a pose")


def type_examples(found, kind, environment, folder, say):
    """Types every line of the blocks of this kind; the number of lines that ended well."""
    done = 0
    lines = [line for language, mark, block in found if (language, mark) == ("sh", kind)
             for line in block]
    for line in lines:
        export = EXPORT.match(line)
        if export:
            environment[export.group(1)] = export.group(2)
            continue
        try:
            ended = subprocess.run(["sh", "-c", line], cwd=folder, env=environment,
                                   stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                   errors="replace", timeout=LINE_LIMIT_S)
        except subprocess.TimeoutExpired:
            say(f"`{line}` did not end within {LINE_LIMIT_S} s")
            break
        if ended.returncode != 0:
            say(f"`{line}` ended with {ended.returncode}:\n{ended.stdout[-2000:]}"
                f"{ended.stderr[-2000:]}")
            break  # what follows rests on it
        print(f"fine: {line}")
        done += 1
    return done


def check_stack(environment, folder, say):
    """What export prints of a stack for job.json is what its file says of itself."""
    done = subprocess.run(["gieson", "export", "GVP-D-S00", "again.ome.tif", "--json"], cwd=folder,
                          env=environment, capture_output=True, text=True, timeout=LINE_LIMIT_S)
    stack = json.loads(done.stdout or "{}").get("stack", {})
    head = (pathlib.Path(folder) / "again.ome.tif").read_bytes() if done.returncode == 0 else b""
    told = {key: [float(re.search(rf'{name}{axis}="([^"]*)"'.encode(), head)[1]) for axis in "XYZ"]
            for key, name in (("size", " Size"), ("pixel_um", "PhysicalSize"), ("origin_um", "Position"))
            if head}
    if not told or stack != told:
        say(f"export says {stack} of a stack whose file says {told}: {done.stderr}")


def type_tutorial(environment, say):
    page = (ROOT / "docs/user/tutorial.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="gieson-tutorial-") as folder:
        if type_examples(blocks(page), "tutorial", environment, folder, say) < 10:
            say("the tutorial was not typed to its end")


def type_readme(bin_folder, environment, say):
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    found = blocks(page)
    help_text = subprocess.run([bin_folder / "gieson", "--help"], capture_output=True, text=True,
                               check=True).stdout
    check_setup(found, say)
    check_programs(found, bin_folder, say)
    check_verbs(page, help_text, say)
    check_json(found, bin_folder, say)
    check_ini(page, bin_folder, say)
    check_docs(bin_folder, help_text, say)
    type_register(bin_folder, say)
    with tempfile.TemporaryDirectory(prefix="gieson-readme-") as folder:
        for name in ("README.md", "docs/user/model.md", "docs/user/reference.md"):
            found = blocks((ROOT / name).read_text(encoding="utf-8"))
            if type_examples(found, "example", environment, folder, say) == 0:
                say(f"{name}: no example was typed to its end")
        check_stack(environment, folder, say)


def main():
    bin_folder = pathlib.Path(sys.argv[1]).resolve()
    complaints = []
    say = complaints.append
    environment = {name: value for name, value in os.environ.items() if name != "GIESON_STORE"}
    environment["PATH"] = f"{bin_folder}{os.pathsep}{environment.get('PATH', '')}"
    if "tutorial" in sys.argv[2:]:
        type_tutorial(environment, say)
    else:
        type_readme(bin_folder, environment, say)
    print("\n".join(complaints) if complaints else "the pages do what they say")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
