# SPDX-License-Identifier: AGPL-3.0-or-later
"""What the tests of the command line share: a store of their own, pictures, pipes and terminals."""
import fcntl
import json
import os
import pathlib
import pty
import random
import select
import struct
import subprocess
import tempfile
import termios
import unicodedata
import unittest
import zlib

BIN = None  # the folder with the programs, set by test_ui.py
SKIPPED = 77


def png(path, width=128, height=128, seed=1):
    """An RGB picture: glass on the right, two dyes in random amounts on the left."""
    rng = random.Random(seed)
    red, yellow = (0.2, 0.85, 0.49), (0.05, 0.2, 0.98)

    def stained(x):
        a, b = (0.6 * rng.random(), 0.5 * rng.random()) if x < 0.6 * width else (0, 0)
        return [max(1, round(250 * 10 ** -(a * red[c] + b * yellow[c]))) for c in range(3)]

    rows = b"".join(b"\0" + b"".join(bytes(stained(x)) for x in range(width))
                    for _ in range(min(height, 128)))
    rows = (rows * (height // 128 + 1))[:height * (3 * width + 1)]  # tall ones repeat themselves

    def chunk(kind, data):
        return (struct.pack(">I", len(data)) + kind + data
                + struct.pack(">I", zlib.crc32(kind + data)))

    data = (b"\x89PNG\r\n\x1a\n"
            + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
    with open(path, "wb") as file:
        file.write(data)
    return data


def ball(path, side=12):
    """A volume: a ball of fading density."""
    def at(x, y, z):
        r = sum((c + 0.5 - side / 2) ** 2 for c in (x, y, z)) ** 0.5
        return max(0, min(200, round(40 * (side / 2 - r))))

    names = f"ObjectType = Image\nNDims = 3\nDimSize = {side} {side} {side}\n"
    names += "ElementSpacing = 0.1 0.1 0.1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    voxels = bytes(at(x, y, z) for z in range(side) for y in range(side) for x in range(side))
    path.write_bytes(names.encode() + voxels)


def columns(line):
    """How wide a terminal shows a line."""
    return sum(0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in "WF"
               else 1 for c in line)


def hold_lock(file, *services):
    """As giesond does, until the file is closed; 0: takes panels in, 1: works the queue."""
    for service in services:
        fcntl.fcntl(file, fcntl.F_OFD_SETLK,
                    struct.pack("hhqqi4x", fcntl.F_WRLCK, 0, service, 1, 0))


class Bench(unittest.TestCase):
    """A folder of its own for every test, and gieson on a store in it."""

    def setUp(self):
        self.temporary = tempfile.TemporaryDirectory(prefix="gieson-ui-")
        self.addCleanup(self.temporary.cleanup)
        self.folder = pathlib.Path(self.temporary.name)
        self.store = self.folder / "store"

    def environment(self, **more):
        known = {k: v for k, v in os.environ.items()
                 if k not in ("GIESON_STORE", "NO_COLOR", "COLUMNS")}
        return {**known, "LC_ALL": "C", "TERM": "xterm", **more}

    def call(self, *args, store=True, env=None, **more):
        """stdout and stderr as text, bytes that are no UTF-8 escaped."""
        command = [str(BIN / "gieson"), *args]
        env = {**({"GIESON_STORE": str(self.store)} if store else {}), **(env or {})}
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE,
                   "stdin": subprocess.DEVNULL, **more}
        return subprocess.run(command, env=self.environment(**env), encoding="utf-8",
                              errors="backslashreplace", check=False, **streams)

    def json(self, *args, code=0):
        done = self.call(*args, "--json")
        self.assertEqual(done.returncode, code, done.stderr)
        return json.loads(done.stdout)

    def refused(self, done, code):
        """Exit code, one line of complaint, nothing on stdout. Gives the line."""
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        self.assertEqual(done.stdout, "")
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertTrue(done.stderr.startswith("gieson: "), done.stderr)
        self.assertTrue(done.stderr.isprintable() or done.stderr[:-1].isprintable(), done.stderr)
        return done.stderr

    def terminal(self, width, *args, env=None):
        """gieson on a terminal of so many columns: exit code and everything it wrote there."""
        screen, inside = pty.openpty()
        fcntl.ioctl(inside, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
        # Our own end stays open until all is read: some kernels drop what the last one leaves.
        env = {"GIESON_STORE": str(self.store), **(env or {})}
        with subprocess.Popen([str(BIN / "gieson"), *args], env=self.environment(**env), stdin=inside, stdout=inside,
                              stderr=inside) as child:
            written = b""
            while True:
                ended = child.poll() is not None
                if select.select([screen], [], [], 0.1)[0]:
                    written += os.read(screen, 65536)
                elif ended:
                    break
        os.close(inside)
        os.close(screen)
        return child.returncode, written.decode("utf-8").replace("\r\n", "\n")

    # ---- what is in the store -----------------------------------------------------------------

    def job(self, name, folder="scans", panels=1, **more):
        """A folder as a scanner leaves it."""
        place = self.folder / folder
        place.mkdir(exist_ok=True)
        for i in range(panels):
            png(place / f"scan_P{i + 1:02}.png", 32, 32, seed=i)
        text = json.dumps({"specimen": name, "px_um": 16, "panels": panels, **more})
        (place / "job.json").write_text(text, encoding="utf-8")
        return str(place)

    def imported(self, name, **more):
        done = self.call("import", self.job(name, **more))
        self.assertEqual(done.returncode, 0, done.stderr)

    def empty_store(self):
        """A store without a specimen: what a refused job.json leaves."""
        place = self.folder / "nothing"
        place.mkdir()
        (place / "job.json").write_text("{}", encoding="utf-8")
        self.assertEqual(self.call("import", str(place)).returncode, 65)

    def reported_tile(self, name="tile"):
        """The quickest way to a report: one picture."""
        picture = self.folder / f"{name}.png"
        png(picture)
        done = self.call("import", "--tile", str(picture))
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.call("run")
        self.assertEqual(done.returncode, 0, done.stderr)
