#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What newcomers get wrong, in job.json and on the command line: each is mended from the first
sentence that is shown.

    mistakes.py BIN    the folder of the programs

A case is a file mistakes/NAME.json:
    what      in words
    job, text job.json, as an object or as it stands; without either there is none
    files     more files beside it, by name
    first     a command before (arguments of gieson; {dir} is the folder that holds in/)
    command   the command; without it `import {dir}/in`
    status    how it ends
    says      part of the first sentence that is told about it
    mended    job, text or command that follow from the sentence: it is not told again, and ends with 0
Every case has one panel, in/Q-P01.png."""
import json
import os
import pathlib
import struct
import subprocess
import sys
import tempfile
import zlib


def png():
    """A grey pixel, whole."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(b"\0\x80")) + chunk(b"IEND", b""))


class Room:
    def __init__(self, programs, folder):
        self.programs, self.folder = programs, pathlib.Path(folder)
        (self.folder / "in").mkdir()
        (self.folder / "in" / "Q-P01.png").write_bytes(png())

    def lay(self, case):
        for name, text in case.get("files", {}).items():
            (self.folder / "in" / name).write_text(text)
        job = case.get("text") or (json.dumps(case["job"]) if "job" in case else None)
        if job:
            (self.folder / "in" / "job.json").write_text(job)

    def call(self, arguments, store):
        environment = {**os.environ, "GIESON_STORE": str(self.folder / store)}
        command = [str(self.programs / "gieson")] + [word.format(dir=self.folder) for word in arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, errors="replace",
                              cwd=self.folder, timeout=120)
        return done.returncode, [line for line in (done.stderr + done.stdout).splitlines() if line]


def complaints_of(programs, case):
    with tempfile.TemporaryDirectory(prefix="gieson-mistake-") as folder:
        room = Room(programs, folder)
        room.lay(case)
        store = "store"
        if "first" in case and room.call(case["first"], store)[0] != 0:
            yield "what comes before does not end well"
        command = case.get("command", ["import", "{dir}/in"])
        status, lines = room.call(command, store)
        if status != case["status"]:
            yield f"ends with {status}, not {case['status']}: {lines[:3]}"
        if not lines or case["says"] not in lines[0]:
            yield f"says first: {lines[:1]}"
        mended = case["mended"]
        room.lay(mended)
        # A job that was taken is mended by --replace; here it is another's first import.
        status, again = room.call(mended.get("command", command),
                                  store if "command" in mended else "mended")
        if status != 0:
            yield f"mended it ends with {status}: {again[:3]}"
        if any(case["says"] in line for line in again):
            yield "mended it is told again"


def main():
    programs = pathlib.Path(sys.argv[1]).resolve()
    cases = sorted((pathlib.Path(__file__).parent / "mistakes").glob("*.json"))
    wrong = 0
    for path in cases:
        case = json.loads(path.read_text())
        for complaint in complaints_of(programs, case):
            wrong += 1
            print(f"{path.stem} ({case['what']}): {complaint}")
    print(f"{len(cases)} mistakes, {wrong} complaints")
    return 1 if wrong or len(cases) < 20 else 0


if __name__ == "__main__":
    sys.exit(main())
