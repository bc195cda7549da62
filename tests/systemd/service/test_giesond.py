#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""giesond and gieson-intake as an administrator runs them, with hot folders for scanners.

    test_giesond.py BIN SCENARIO

BIN is the folder with the programs. Scenarios are the functions marked as such below; each ends the
processes it started. Exit 0: all that was demanded holds; 77: it cannot be tried here.

GIESON_KILLS=200: as many kills in `killed` as that, and in each of GIESON_ROUNDS of `slow_writers`. GIESON_REST_S=60: `rest` measures so long."""
import hashlib
import json
import os
import pathlib
import random
import re
import shlex
import shutil
import signal
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zlib

SKIPPED = 77
GENEROUS_S = 60  # the machine may be busy; nothing that works comes near
SCENARIOS = {}


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


def picture(number):
    """A PNG of its own for each number."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + \
            struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + number.to_bytes(4, "big") * 6 for _ in range(8))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def demand(claim, sentence):
    if not claim:
        raise SystemExit(f"not true: {sentence}")


class Bench:
    """A store, a hot folder and a configuration of their own; the service when it was started."""

    def __init__(self, programs, folder):
        self.programs = pathlib.Path(programs).resolve()
        self.folder = pathlib.Path(folder)
        self.store = self.folder / "store"
        self.hot = self.folder / "hot"
        self.config = self.folder / "gieson.conf"
        self.log = self.folder / "log"
        self.service = None
        self.ends = []  # what else is to be called at the end
        self.environment = dict(os.environ)
        for name in ("GIESON_STORE", "JOURNAL_STREAM", "NOTIFY_SOCKET", "WATCHDOG_USEC"):
            self.environment.pop(name, None)
        self.hot.mkdir()

    def configure(self, reserve=1, patience=30, more="", work=""):
        # No limit of memory: AddressSanitizer reserves more than any machine has.
        self.config.write_text(
            f"[store]\nReserveMiB={reserve}\n[work]\nMemoryMiB=0\n{work}"
            f"[source flatbed]\nAddress=hot:{self.hot}\nSettleMs=50\nSweepS=1\n"
            f"PatienceS={patience}\n{more}")

    def start(self, *arguments, log=None):
        command = [str(self.programs / "giesond"), "--store", str(self.store),
                   "--config", str(self.config), *arguments]
        with open(self.log, "ab") as file:
            self.service = subprocess.Popen(command, stderr=log or file, stdout=file,
                                            env=self.environment)

    def stop(self):
        if self.service and self.service.poll() is None:
            self.service.terminate()
            try:
                self.service.wait(GENEROUS_S)
            except subprocess.TimeoutExpired:
                self.service.kill()
                self.service.wait()
                raise SystemExit("giesond did not end when asked to")

    def words(self):
        return self.log.read_text(errors="replace") if self.log.exists() else ""

    def ask(self, sql, *values):
        """None while the store is not there yet."""
        try:
            with sqlite3.connect(f"file:{self.store}/gieson.db?mode=ro", uri=True, timeout=10) as db:
                return db.execute(sql, values).fetchall()
        except sqlite3.OperationalError:
            return None

    def wait(self, what, condition, seconds=GENEROUS_S):
        end = time.monotonic() + seconds
        while not condition():
            if self.service and self.service.poll() is not None:
                raise SystemExit(f"giesond ended with {self.service.returncode} while waiting for "
                                 f"{what}\n{self.words()}")
            if time.monotonic() > end:
                raise SystemExit(f"waited {seconds} s in vain for {what}\n{self.words()}\n"
                                 f"{self.ask('SELECT * FROM source')}")
            time.sleep(0.02)

    def state(self):
        rows = self.ask("SELECT state FROM source WHERE name = 'flatbed'")
        return rows[0][0] if rows else None

    def wait_ready(self):
        self.wait("the source to be ready", lambda: self.state() == "ready")

    def deliver(self, name, data):
        """As a careful scanner does it: under a name that nobody looks at, then renamed."""
        hidden = self.hot / f".{name}"
        hidden.write_bytes(data)
        hidden.rename(self.hot / name)

    def scans(self, name):
        rows = self.ask("SELECT sha256, state FROM scan WHERE name = ?", name)
        return rows or []

    def wait_scan(self, name):
        self.wait(f"a scan of {name}", lambda: self.scans(name))

    def intake(self):
        """The process of the source, or None."""
        for entry in os.listdir("/proc"):
            if not entry.isdigit():
                continue
            try:
                words = pathlib.Path(f"/proc/{entry}/cmdline").read_bytes().split(b"\0")
                stat = pathlib.Path(f"/proc/{entry}/stat").read_text()
            except OSError:
                continue
            fields = stat.rsplit(")", 1)[1].split()
            if words[0].endswith(b"gieson-intake") and int(fields[1]) == self.service.pid \
                    and fields[0] != "Z":
                return int(entry)
        return None

    def check_whole(self, delivered):
        """Every picture is one row and its exact bytes; nothing is left over."""
        rows = self.ask("SELECT name, sha256, count(*) FROM scan GROUP BY name")
        found = {name: (digest, count) for name, digest, count in rows}
        for name, data in delivered.items():
            digest = hashlib.sha256(data).hexdigest()
            demand(found.get(name) == (digest, 1), f"{name} is one scan: {found.get(name)}")
            path = self.store / "objects" / digest[:2] / digest[2:]
            demand(path.read_bytes() == data, f"the object of {name} has its bytes")
        demand(len(found) == len(delivered), "there are no other scans")
        demand(self.ask("PRAGMA integrity_check") == [("ok",)], "the database is whole")
        panels = self.ask("SELECT count(*), count(DISTINCT sha256) FROM panel")[0]
        demand(panels[0] == panels[1], f"no panel is doubled: {panels}")

    def add_specimen(self, name):
        """As an import would have made it."""
        with sqlite3.connect(f"{self.store}/gieson.db", timeout=10) as db:
            db.executescript(
                "INSERT OR IGNORE INTO study VALUES (1, 'st');"
                "INSERT OR IGNORE INTO study_group VALUES (1, 1, 'g');"
                "INSERT OR IGNORE INTO animal VALUES (1, 1, 'rat');")
            db.execute("INSERT INTO specimen (name, study_id, group_id, animal_id, kind, baseline, "
                       "job_json, job_sha256) VALUES (?, 1, 1, 1, 'sections', '', '{}', "
                       "printf('%064d', 0))", (name,))


# ---- what comes in ----------------------------------------------------------------------------

@scenario
def delivers(bench):
    """A picture nobody can place is unfiled; one named after a specimen is its panel."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.add_specimen("GVP-D-S02")
    delivered = {"lonely.png": picture(1), "GVP-D-S02-P03.png": picture(2)}
    for name, data in delivered.items():
        bench.deliver(name, data)
        bench.wait_scan(name)
    demand(bench.scans("lonely.png")[0][1] == "unfiled", "lonely.png waits for a person")
    demand(bench.scans("GVP-D-S02-P03.png")[0][1] == "filed", "the named one is filed")
    demand(bench.ask("SELECT number FROM panel") == [(3,)], "it is panel 3")
    demand(bench.ask("SELECT count(*) FROM job WHERE kind = 'panel'") == [(1,)], "a job waits")
    (bench.hot / "empty.png").write_bytes(b"")
    (bench.hot / "notes.txt").write_text("not a picture")
    bench.deliver("later.png", picture(3))
    bench.wait_scan("later.png")
    delivered["later.png"] = picture(3)
    bench.stop()
    demand(bench.state() == "off", "a source whose service was stopped is off")
    demand("notes.txt: is no picture" in bench.words(), "what is left alone is named")
    bench.check_whole(delivered)


@scenario
def specimen(bench):
    """A folder with a job.json is taken in as a whole, and what is wrong with one is a trouble."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    made = bench.folder / "GVP-D-S00"
    subprocess.run([bench.programs / "gieson", "phantom", "--specimen", "S00", "--level", "L0",
                    "--seed", "1", "--out", made], check=True, stdout=subprocess.DEVNULL)
    panels = len(list(made.glob("*-P*.*")))
    wrong = bench.hot / "wrong"
    wrong.mkdir()
    (wrong / "job.json").write_text("{ no json")
    (wrong / "P1.png").write_bytes(picture(1))
    shutil.copytree(made, bench.hot / "GVP-D-S00")
    bench.wait("the specimen's panels", lambda: bench.ask("SELECT count(*) FROM panel") ==
               [(panels,)])
    bench.wait("the trouble", lambda: bench.ask("SELECT name FROM trouble") == [("wrong",)])
    reason = bench.ask("SELECT reason FROM trouble")[0][0]
    demand("job.json" in reason, "its reason is told")
    bench.wait("two more tries", lambda: bench.ask("SELECT tries FROM trouble")[0][0] >= 3)
    demand(bench.words().count(reason) <= 2, f"who tries again says nothing new: {bench.words()}")
    demand("<6>" not in bench.words(), "priorities are for the journal")
    for file in made.glob("region*"):
        shutil.copy(file, wrong)
    text = json.loads((made / "job.json").read_text())
    text["specimen"] = "corrected"
    del text["region"]  # a mask that is not in this folder
    (wrong / "job.json").write_text(json.dumps(text))
    bench.wait("the corrected folder", lambda: bench.ask("SELECT name FROM trouble") == [])
    demand(bench.ask("SELECT count(*) FROM specimen") == [(2,)], "both are specimens")


def as_nobody(bench):
    """Permissions do not bind root: from here on this is somebody whom they do."""
    nobody = 65534
    if os.geteuid() == 0:
        for path in (bench.folder, bench.hot):
            os.chown(path, nobody, nobody)
        os.setgroups([])
        os.setgid(nobody)
        os.setuid(nobody)


def read_status(bench):
    told = subprocess.run([bench.programs / "gieson", "--store", bench.store, "status", "--json"],
                          env=bench.environment, check=True, capture_output=True)
    return {row["name"]: row for row in json.loads(told.stdout)["troubles"]}


@scenario
def barred(bench):
    """What cannot be taken in is a row with what to do, and stands in nothing's way. Each is over
    when a person has done it."""
    as_nobody(bench)
    bench.configure(patience=2)
    bench.start("--only", "intake")
    bench.wait_ready()
    secret = bench.folder / "secret"
    secret.write_bytes(picture(1))
    expected = {  # name: (words of the reason, words of the action)
        "denied.png": ("may not be read", "chmod a+r"),
        "link.png": ("is a link", "put the file itself"),
        ".hidden.png": ("begins with a dot", "rename it"),
        "huge.png": ("no file may have more than 1073741824 (1 GiB)", "take it out"),
        "nojob": ("no job.json", "write '"),
        "deniedjob": ("may not be read", "chmod -R a+rX"),
        "closed": ("may not be looked into", "chmod -R a+rX"),
        "S02/P2.png": ("may not be read", "chmod a+r"),
    }
    bench.deliver("denied.png", picture(2))
    (bench.hot / "denied.png").chmod(0)
    (bench.hot / "link.png").symlink_to(secret)
    (bench.hot / ".hidden.png").write_bytes(picture(3))
    with open(bench.hot / "huge.png", "wb") as file:
        file.truncate((1 << 30) + 1)
    for name in ("nojob", "deniedjob", "closed", "S02"):
        (bench.hot / name).mkdir()
        (bench.hot / name / "P1.png").write_bytes(picture(len(name)))
    (bench.hot / "closed").chmod(0)
    for name, mode in (("deniedjob", 0), ("S02", 0o644)):  # never readable for a moment
        unnamed = bench.folder / f"job of {name}"
        unnamed.write_text(json.dumps({"specimen": name}))
        unnamed.chmod(mode)
        unnamed.rename(bench.hot / name / "job.json")
    (bench.hot / "S02" / "P2.png").write_bytes(picture(20))
    (bench.hot / "S02" / "P2.png").chmod(0)
    bench.wait("all rows", lambda: {r[0] for r in bench.ask("SELECT name FROM trouble")} ==
               set(expected))
    rows = read_status(bench)
    for name, (reason, action) in expected.items():
        demand(reason in rows[name]["reason"], f"{name}: {rows[name]['reason']}")
        demand(action in rows[name]["action"], f"{name}: {rows[name]['action']}")
    for verb in ("status", "top"):  # without a terminal a table, once
        said = subprocess.run([bench.programs / "gieson", "--store", bench.store, verb], text=True,
                              env=bench.environment, check=True, capture_output=True).stdout
        for name, (_, action) in expected.items():
            demand(name in said and "trouble" in said and action in said, f"{name} in\n{said}")
    bench.wait("the panel that can be had", lambda: bench.ask("SELECT file_name FROM panel") ==
               [("P1.png",)])
    bench.deliver("later.png", picture(4))
    bench.wait_scan("later.png")
    (bench.hot / "denied.png").chmod(0o644)
    (bench.hot / "link.png").unlink()
    (bench.hot / ".hidden.png").rename(bench.hot / "shown.png")
    (bench.hot / "huge.png").unlink()
    (bench.hot / "nojob" / "job.json").write_text(json.dumps({"specimen": "nojob"}))
    (bench.hot / "deniedjob" / "job.json").chmod(0o644)
    (bench.hot / "closed").chmod(0o755)
    shutil.rmtree(bench.hot / "closed")
    (bench.hot / "S02" / "P2.png").chmod(0o644)
    bench.wait("no row", lambda: bench.ask("SELECT name FROM trouble") == [])
    bench.wait("all panels", lambda: bench.ask("SELECT count(*) FROM panel") == [(4,)])
    bench.check_whole({"denied.png": picture(2), "shown.png": picture(3), "later.png": picture(4)})


CLOSING_WORKER = """#!/bin/sh
# The job.json of a folder called denied may no longer be read when the import begins.
case "$4" in *denied) chmod 0 "$4/job.json" ;; *broken) kill -KILL $$ ;; esac
exec {worker} "$@"
"""


@scenario
def import_fails(bench):
    """What to do about a folder whose import fails follows from why it failed."""
    as_nobody(bench)
    place = bench.folder / "bin"
    place.mkdir()
    for name in ("giesond", "gieson-intake"):
        shutil.copy(bench.programs / name, place / name)
    (place / "gieson-work").write_text(
        CLOSING_WORKER.format(worker=shlex.quote(str(bench.programs / "gieson-work"))))
    (place / "gieson-work").chmod(0o755)
    bench.configure(patience=2)
    bench.programs, real = place, bench.programs
    bench.start("--only", "intake")
    bench.programs = real
    bench.wait_ready()
    expected = {
        "denied": ("job.json may not be read", f"chmod -R a+rX '{bench.hot}/denied'"),
        "broken": ("gieson-work ended with 137", "look at the journal"),
        "wrong": ("job.json", "correct the folder"),
    }
    for name in expected:
        (bench.hot / name).mkdir()
        (bench.hot / name / "P1.png").write_bytes(picture(len(name)))
        (bench.hot / name / "job.json").write_text("{" if name == "wrong" else
                                                   json.dumps({"specimen": name}))
    bench.wait("all rows", lambda: len(bench.ask("SELECT name FROM trouble")) == len(expected))
    rows = read_status(bench)
    for name, (reason, action) in expected.items():
        demand(reason in rows[name]["reason"] and action in rows[name]["action"], rows[name])


@scenario
def import_leaves_out(bench):
    """`gieson import` of a folder with a panel that may not be read, or a link, says so, takes the
    rest and does not end as if all were well; the next one that finds it mended ends the rows."""
    as_nobody(bench)
    folder = bench.folder / "jq"
    folder.mkdir()
    (folder / "job.json").write_text(json.dumps({"specimen": "Q", "px_um": 16, "panels": 3}))
    for number in range(1, 4):
        (folder / f"Q-P0{number}.png").write_bytes(picture(number))
    (folder / "Q-P02.png").chmod(0)
    (folder / "Q-P04.png").symlink_to("nowhere")

    def take():
        return subprocess.run([bench.programs / "gieson", "--store", bench.store, "import", folder,
                               "--json"], env=bench.environment, capture_output=True, text=True)
    took = take()
    demand(took.returncode == 77, f"{took.returncode}: {took.stderr}")
    demand("Q-P02.png: not taken: it may not be read" in took.stderr and
           f"chmod a+r '{folder}/Q-P02.png'" in took.stderr, took.stderr)
    demand("Q-P04.png: not taken: it is a link" in took.stderr, took.stderr)
    told = json.loads(took.stdout)
    demand(told["panels_taken"] == 2 and [row["name"] for row in told["left_out"]] ==
           ["Q-P02.png", "Q-P04.png"], took.stdout)
    rows = read_status(bench)
    demand(set(rows) == {f"{folder}/Q-P02.png", f"{folder}/Q-P04.png"}, rows)
    (folder / "Q-P02.png").chmod(0o644)
    (folder / "Q-P04.png").unlink()
    took = take()
    demand(took.returncode == 0 and json.loads(took.stdout)["left_out"] == [], took.stderr)
    demand(read_status(bench) == {}, "the rows are over")
    # A mask that is a link would be read, and kept for everybody to read.
    secret = bench.folder / "secret"
    secret.write_text("the key")
    (folder / "roi.mhd").symlink_to(secret)
    (folder / "job.json").write_text(json.dumps({"specimen": "R", "region": "roi.mhd"}))
    took = take()
    demand(took.returncode == 65 and 'names "roi.mhd": roi.mhd is a link' in took.stderr,
           took.stderr)
    digest = hashlib.sha256(b"the key").hexdigest()
    demand(not (bench.store / "objects" / digest[:2] / digest[2:]).exists(), "it is not kept")


def scan_of(number, size):
    """A TIFF of its own for each number, its directory at the end, as libtiff writes one strip."""
    width = 64
    rows = max(1, size // width)
    pixels = number.to_bytes(4, "big") + bytes((i * 7) % 251 + 1 for i in range(4, width * rows))
    entries = [(256, 4, width), (257, 4, rows), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8),
               (277, 3, 1), (278, 4, rows), (279, 4, len(pixels))]
    return b"II*\0" + struct.pack("<I", 8 + len(pixels)) + pixels + \
        struct.pack("<H", len(entries)) + \
        b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries) + \
        struct.pack("<I", 0)


def write_slowly(path, data, way, pause):
    """In one of eight ways; the pause is taken in the middle of it."""
    half = len(data) // 2

    def put(name, mode, *parts):
        with open(name, mode, buffering=0) as file:
            for at, part in parts:
                if at is None:
                    time.sleep(pause)
                else:
                    file.seek(at)
                    file.write(part)
    if way == 0:    # appended
        put(path, "wb", (0, data[:half]), (None, None), (half, data[half:]))
    elif way == 1:  # made to its length, filled from the front
        put(path, "wb", (len(data) - 1, b"\0"), (0, data[:half]), (None, None), (half, data[half:]))
    elif way == 2:  # made to its length with its header, then nothing for long
        put(path, "wb", (len(data) - 1, b"\0"), (0, data[:8]), (None, None), (8, data[8:]))
    elif way == 3:  # under a hidden name, renamed
        hidden = path.with_name("." + path.name)
        put(hidden, "wb", (0, data[:half]), (None, None), (half, data[half:]))
        hidden.rename(path)
    elif way == 4:  # the end first
        put(path, "wb", (half, data[half:]), (None, None), (0, data[:half]))
    elif way == 5:  # opened anew for each piece
        put(path, "wb", (0, data[:half]))
        time.sleep(pause)
        put(path, "r+b", (half, data[half:]))
    elif way == 6:  # a first try that is thrown away
        put(path, "wb", (0, data[:half]), (None, None))
        put(path, "wb", (0, data))
    else:           # under another name in the folder, linked to its own
        other = path.with_name(path.name + ".part")
        put(other, "wb", (0, data[:half]), (None, None), (half, data[half:]))
        os.link(other, path)
        other.unlink()


class Disk:
    """A file system under the hot folder, as a network folder is one. Writers have their files open in
    it and their folder by another mount of it, so they go on when it is pulled from under the
    service: `umount -l` and, after a while, the same file system again."""

    def __init__(self, bench):
        self.hot = bench.hot
        self.writers = bench.folder / "share"
        self.writers.mkdir()
        bench.ends.append(self.done)
        self.mounted = self.run("mount", "-t", "tmpfs", "-o", "size=256m", "share", self.writers) and \
            self.run("mount", "--bind", self.writers, self.hot)
        if not self.mounted:
            self.run("umount", self.writers)
            self.writers = self.hot

    @staticmethod
    def run(*words):
        return subprocess.run(list(map(str, words)), stderr=subprocess.DEVNULL, check=False).returncode == 0

    def pull(self, seconds):
        """Returns how often it was away: 0 or 1."""
        if not self.mounted or not self.run("umount", "-l", self.hot):
            return 0
        time.sleep(seconds)
        demand(self.run("mount", "--bind", self.writers, self.hot), "it is mounted again")
        return 1

    def done(self):
        if self.mounted:
            self.run("umount", "-l", self.hot)
            self.run("umount", "-l", self.writers)


@scenario
def slow_writers(bench):
    """Eight ways to write, some resting for longer than anybody waits, while the intake is killed:
    each picture is one panel with its last bytes, and nothing that came in is gone. Where it may
    (root), the folder is a file system that is unmounted under the service meanwhile, writers and
    all, and mounted again."""
    kills = int(os.environ.get("GIESON_KILLS", "4"))
    rounds = int(os.environ.get("GIESON_ROUNDS", "1"))
    dice = random.Random(24)
    disk = Disk(bench)
    unmounts = 0
    bench.configure(patience=2)
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.add_specimen("S")
    delivered = {}
    for turn in range(rounds):
        writers = []
        for way in range(8):
            for pause in (0.2, 10):
                number = len(delivered) + 1
                name = f"S-P{number:03}.tif"
                delivered[name] = scan_of(number, dice.randrange(2000, 90000))
                writers.append(threading.Thread(
                    target=write_slowly, args=(disk.writers / name, delivered[name], way, pause)))
        for writer in writers:
            writer.start()
        for _ in range(kills):
            time.sleep(dice.uniform(0.3, 1.5))
            victim = bench.intake()
            if victim:
                os.kill(victim, signal.SIGKILL)
            unmounts += disk.pull(dice.uniform(0.1, 2))
        for writer in writers:
            writer.join()
    expected = {(name, hashlib.sha256(data).hexdigest()) for name, data in delivered.items()}
    demand(len({digest for _, digest in expected}) == len(delivered), "no two pictures are alike")

    def differing():
        return sorted(expected ^ set(bench.ask("SELECT file_name, sha256 FROM panel") or ()))
    try:
        bench.wait("every panel with its last bytes", lambda: not differing(), 120)
    except SystemExit as waited:
        raise SystemExit(f"{waited}\nnot alike: {differing()}") from None
    demand(bench.ask("SELECT count(*) FROM panel") == [(len(delivered),)], "none is there twice")
    demand(bench.ask("SELECT count(*) FROM panel WHERE state = 'held'") == [(0,)], "none is held")
    for (digest,) in bench.ask("SELECT DISTINCT sha256 FROM scan"):
        data = (bench.store / "objects" / digest[:2] / digest[2:]).read_bytes()
        demand(hashlib.sha256(data).hexdigest() == digest, f"the object {digest} is whole")
    torn = bench.ask("SELECT count(*) FROM scan WHERE state = 'kept' AND reason LIKE '%torn%'")
    print(f"{len(delivered)} pictures, {kills * rounds} kills, {unmounts} unmounts, {torn[0][0]} torn "
          "beginnings replaced: 0 lost, 0 double")


@scenario
def import_hangs(bench):
    """A folder whose import hangs is a trouble with a sentence, and the next picture comes in."""
    with_fake_worker(bench, "hang")
    bench.configure(patience=2)
    bench.start("--only", "intake")
    bench.wait_ready()
    folder = bench.hot / "S01"
    folder.mkdir()
    (folder / "P1.png").write_bytes(picture(1))
    (folder / "job.json").write_text("{}")
    bench.wait("the trouble", lambda: bench.ask("SELECT name FROM trouble") == [("S01",)])
    reason = bench.ask("SELECT reason FROM trouble")[0][0]
    demand("did nothing for 2 s" in reason, reason)
    bench.deliver("a.png", picture(2))
    bench.wait_scan("a.png")
    demand("silent for" not in bench.words(), "the source itself was never given up")


@scenario
def watched(bench):
    """--watch needs no configuration."""
    bench.config = bench.folder / "nowhere.conf"
    bench.start("--watch", str(bench.hot), "--only", "intake")
    bench.deliver("a.png", picture(1))
    bench.wait_scan("a.png")
    demand(bench.ask("SELECT name, state FROM source") == [("hot", "ready")], "it is named hot")


@scenario
def reserve(bench):
    """Case 56. Below the reserve of disk nothing is taken; with room again everything is."""
    free = shutil.disk_usage(bench.folder).free >> 20
    bench.configure(reserve=free + 100000)
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.deliver("a.png", picture(1))
    bench.wait("the pause", lambda: bench.state() == "paused")
    message = bench.ask("SELECT message FROM source")[0][0]
    demand("below its reserve" in message, f"the sentence says why: {message}")
    demand(not bench.scans("a.png"), "nothing was taken")
    bench.configure(reserve=1)
    bench.service.send_signal(signal.SIGHUP)
    bench.wait_scan("a.png")
    bench.wait_ready()


@scenario
def returning_folder(bench):
    """A folder that goes away (a mount) is away, and served again when it is back."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.hot.rename(bench.folder / "gone")
    bench.wait("the source to be away", lambda: bench.state() == "away")
    (bench.folder / "gone").rename(bench.hot)
    bench.deliver("a.png", picture(1))
    bench.wait_scan("a.png")
    bench.wait_ready()


@scenario
def requests(bench):
    """A folder takes no pictures when asked to, and says so."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    with sqlite3.connect(f"{bench.store}/gieson.db", timeout=10) as db:
        db.execute("INSERT INTO request (time, actor, kind, source) VALUES (0, 'ann', "
                   "'capture-blank', 'flatbed')")
    bench.wait("the answer", lambda: bench.ask("SELECT state FROM request") == [("refused",)])
    demand("by themselves" in bench.ask("SELECT message FROM request")[0][0], "it says why")


# ---- death and hanging ------------------------------------------------------------------------

@scenario
def killed(bench):
    """Killed at any time, the intake is back soon; nothing is lost and nothing doubled."""
    kills = int(os.environ.get("GIESON_KILLS", "20"))
    chance = random.Random(4)
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    delivered, back, over = {}, [], threading.Event()

    def scan_on():
        number = 0
        while not over.is_set():
            number += 1
            name = f"P{number}.png"
            data = picture(number)
            bench.deliver(name, data)
            delivered[name] = data
            over.wait(0.05)

    scanner = threading.Thread(target=scan_on)
    scanner.start()
    try:
        for _ in range(kills):
            time.sleep(chance.uniform(0, 0.4))
            bench.wait("an intake", bench.intake)
            before = bench.intake()
            began = time.monotonic()
            os.kill(before, signal.SIGKILL)
            bench.wait("another intake", lambda: bench.intake() not in (None, before))
            seen = bench.ask("SELECT coalesce(max(id), 0) FROM scan")[0][0]
            bench.wait("it to deliver", lambda: bench.ask("SELECT coalesce(max(id), 0) FROM scan")
                       [0][0] > seen)
            back.append(time.monotonic() - began)
    finally:
        over.set()
        scanner.join()
    bench.wait("all pictures", lambda: bench.ask("SELECT count(*) FROM scan")[0][0] >=
               len(delivered))
    bench.stop()
    bench.check_whole(delivered)
    left = list((bench.store / "objects" / "tmp").iterdir())
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.deliver("last.png", picture(0))
    bench.wait_scan("last.png")
    bench.stop()
    after = [p for p in (bench.store / "objects" / "tmp").iterdir()
             if not p.name.startswith("partial-")]
    demand(not after, f"temporaries are swept: {after} of {len(left)}")
    back.sort()
    print(f"{kills} kills, {len(delivered)} pictures: delivering again after {back[len(back) // 2]:.2f} s "
          f"(median), {back[-1]:.2f} s at worst")


@scenario
def daemon_killed(bench):
    """When giesond itself is killed its intake ends too, and a new one goes on."""
    bench.configure()
    delivered = {}
    for number in range(5):
        bench.start("--only", "intake")
        bench.wait("an intake", bench.intake)
        intake = bench.intake()
        delivered[f"P{number}.png"] = picture(number)
        bench.deliver(f"P{number}.png", picture(number))
        if number % 2:
            bench.wait_scan(f"P{number}.png")
        bench.service.kill()
        bench.service.wait()
        end = time.monotonic() + GENEROUS_S
        while os.path.exists(f"/proc/{intake}") and time.monotonic() < end:
            time.sleep(0.02)
        demand(not os.path.exists(f"/proc/{intake}"), "the orphaned intake ended")
    bench.start("--only", "intake")
    for name in delivered:
        bench.wait_scan(name)
    bench.stop()
    bench.check_whole(delivered)


@scenario
def hangs(bench):
    """An intake that is silent for its patience is killed and started again."""
    bench.configure(patience=2)
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.wait("an intake", bench.intake)
    before = bench.intake()
    os.kill(before, signal.SIGSTOP)
    bench.deliver("a.png", picture(1))
    bench.wait("another intake", lambda: bench.intake() not in (None, before))
    bench.wait_scan("a.png")
    demand("silent for 2 s" in bench.words(), "it is said why")


@scenario
def intake_stopped(bench):
    """An intake that somebody stops politely is started again, too."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.wait("an intake", bench.intake)
    before = bench.intake()
    os.kill(before, signal.SIGTERM)
    bench.wait("another intake", lambda: bench.intake() not in (None, before))
    bench.deliver("a.png", picture(1))
    bench.wait_scan("a.png")


@scenario
def replays(bench):
    """A source that ends is served once, and is not started again."""
    bench.deliver("a.png", picture(1))
    bench.config.write_text(f"[store]\nReserveMiB=1\n[source flatbed]\nAddress=replay:{bench.hot}\n"
                            "SettleMs=50\nSweepS=1\n")
    bench.start("--only", "intake")
    bench.wait_scan("a.png")
    bench.wait("its end", lambda: "has ended" in bench.words())
    demand(bench.ask("SELECT state, message FROM source")[0] ==
           ("ready", "everything in it is taken in"), "the row says so")


@scenario
def ends(bench):
    """SIGTERM ends the service within two seconds, in the middle of anything, and it says off."""
    bench.configure()
    bench.start()
    bench.wait_ready()
    for number in range(200):
        bench.deliver(f"P{number}.png", picture(number))
    bench.wait_scan("P0.png")
    began = time.monotonic()
    bench.service.terminate()
    status = bench.service.wait(GENEROUS_S)
    took = time.monotonic() - began
    demand(status == 0, f"it ended with {status}")
    demand(bench.state() == "off", "its source is off")
    print(f"ended after {took:.2f} s")
    demand(took < 10, f"it took {took:.1f} s")
    bench.start("--only", "intake")
    bench.wait("all pictures", lambda: bench.ask("SELECT count(*) FROM scan")[0][0] >= 200)
    bench.stop()
    bench.check_whole({f"P{n}.png": picture(n) for n in range(200)})


@scenario
def crashes(bench):
    """An intake that fails by itself is started again later each time, and its row says so."""
    place = bench.folder / "bin"
    place.mkdir()
    for name in ("giesond", "gieson-work"):
        shutil.copy(bench.programs / name, place / name)
    fake = place / "gieson-intake"
    fake.write_text(f"#!/bin/sh\ndate +%s.%N >> {bench.folder}/starts\nkill -SEGV $$\n")
    fake.chmod(0o755)
    bench.programs = place
    bench.configure()
    bench.start("--only", "intake")
    starts = bench.folder / "starts"
    bench.wait("three starts", lambda: starts.exists() and len(starts.read_text().split()) >= 3)
    first, second, third = map(float, starts.read_text().split()[:3])
    demand(second - first >= 0.9 and third - second >= 1.9, f"{first} {second} {third}")
    demand(bench.state() == "failed" and "signal 11" in bench.words(), bench.words())


@scenario
def away(bench):
    """Case 1. A device that is not there is away, said once, and costs but a look now and then."""
    bench.config.write_text("[store]\nReserveMiB=1\n[source cam]\n"
                            "Address=ptp:no-such-serial\n")
    bench.start("--only", "intake")
    bench.wait("the source to be away", lambda: bench.ask("SELECT state FROM source") ==
               [("away",)])
    message = bench.ask("SELECT message FROM source")[0][0]
    demand(message.startswith('no scanner or camera (USB Still Image class) answers to '
                              '"no-such-serial"') and
           message.endswith("is it switched on and set to PTP?"), f"it says which: {message}")
    bench.wait("the intake to end", lambda: not bench.intake())
    demand(bench.words().count(message) == 1, bench.words())


# ---- the configuration ------------------------------------------------------------------------

@scenario
def reloads(bench):
    """SIGHUP: what is new is served, what is gone is off, a wrong configuration changes nothing."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.wait("an intake", bench.intake)
    kept = bench.intake()
    second = bench.folder / "second"
    second.mkdir()
    bench.configure(more=f"[source second]\nAddress=hot:{second}\nSettleMs=50\n")
    bench.service.send_signal(signal.SIGHUP)
    bench.wait("the second source", lambda: bench.ask(
        "SELECT state FROM source WHERE name = 'second'") == [("ready",)])
    demand(os.path.exists(f"/proc/{kept}"), "the first one was left alone")
    bench.configure(more="Nonsense=1\n")
    bench.service.send_signal(signal.SIGHUP)
    bench.wait("the mistake", lambda: "the old configuration stays" in bench.words())
    demand(re.search(r"gieson\.conf:\d+: .*Nonsense", bench.words()), "file and line are told")
    (second / "a.png").write_bytes(picture(1))
    bench.wait_scan("a.png")
    bench.configure()
    bench.service.send_signal(signal.SIGHUP)
    bench.wait("the second source to be off", lambda: bench.ask(
        "SELECT state FROM source WHERE name = 'second'") == [("off",)])


def status_of(pid):
    return pathlib.Path(f"/proc/{pid}/status").read_text()


def is_pending(pid, number):
    try:
        status = status_of(pid)
    except FileNotFoundError:
        return True  # it has been asked long since, and ended
    return any(int(bits, 16) >> (number - 1) & 1
               for bits in re.findall(r"(?:SigPnd|ShdPnd):\s*([0-9a-f]+)", status))


@scenario
def reload_too_late(bench):
    """SIGHUP while the service stops starts nothing that would keep it from ending."""
    bench.configure()
    bench.start("--only", "intake")
    bench.wait_ready()
    bench.wait("an intake", bench.intake)
    frozen = bench.intake()
    os.kill(frozen, signal.SIGSTOP)  # so that stopping takes its time
    bench.wait("it to stand still", lambda: "State:\tT" in status_of(frozen))
    second = bench.folder / "second"
    second.mkdir()
    bench.configure(more=f"[source second]\nAddress=hot:{second}\nSettleMs=50\n")
    bench.service.send_signal(signal.SIGTERM)
    bench.wait("the intake to be asked to stop", lambda: is_pending(frozen, signal.SIGTERM))
    bench.service.send_signal(signal.SIGHUP)
    bench.stop()
    demand(bench.service.returncode == 0, bench.words())


@scenario
def checks(bench):
    """--check-config says what is wrong and where, and touches nothing."""
    def run():
        return subprocess.run([bench.programs / "giesond", "--check-config", "--config",
                               bench.config], capture_output=True, text=True, timeout=GENEROUS_S,
                              env=bench.environment, check=False)
    bench.configure()
    fine = run()
    demand(fine.returncode == 0 and "1 source" in fine.stdout, f"a good one: {fine}")
    bench.configure(more="Gain=3\n", work="Workers=x\n")
    wrong = run()
    lines = wrong.stderr.splitlines()
    demand(wrong.returncode == 78 and len(lines) == 2, f"two mistakes: {wrong}")
    demand(all(re.match(r".*gieson\.conf:\d+: .", line) for line in lines), f"places: {lines}")
    demand(not bench.store.exists(), "no store was made")
    bench.start()
    demand(bench.service.wait(GENEROUS_S) == 78, "a service does not start on it")


# ---- the queue --------------------------------------------------------------------------------

FAKE_WORKER = """#!{python}
# Claims a job as gieson-work would, and does what the file `do` beside it says.
import os, pathlib, sqlite3, sys, time
here = pathlib.Path(sys.argv[0]).parent
if "import" in sys.argv:
    time.sleep(3600)
store = sys.argv[sys.argv.index("--store") + 1]
db = sqlite3.connect(store + "/gieson.db", timeout=10, isolation_level=None)
boot = open("/proc/sys/kernel/random/boot_id").read().strip()
start = int(open("/proc/self/stat").read().rsplit(")", 1)[1].split()[19])
db.execute("BEGIN IMMEDIATE")
row = db.execute("SELECT id FROM job WHERE state = 'waiting' OR (state = 'running' AND pid <> 0 AND "
                 "NOT EXISTS (SELECT 1)) ORDER BY id LIMIT 1").fetchone()
if not row:
    sys.exit(66)
db.execute("UPDATE job SET state = 'running', claim = claim + 1, owner = 'fake', boot = ?, "
           "processes = ?, pid = ?, pid_start = ?, lease_s = 600, lease_until = ? WHERE id = ?",
           (boot, os.readlink("/proc/self/ns/pid"), os.getpid(), start,
            int(time.clock_gettime(time.CLOCK_BOOTTIME)) + 600, row[0]))
db.execute("COMMIT")
(here / "limits").write_text(open("/proc/self/limits").read() + "nice " + str(os.nice(0)))
while (here / "do").read_text() == "hang":
    time.sleep(0.05)
db.execute("UPDATE job SET state = 'done', pid = 0 WHERE id = ?", row)
"""


def with_fake_worker(bench, what):
    """The service beside a gieson-work whose behaviour the test decides."""
    place = bench.folder / "bin"
    place.mkdir()
    for name in ("giesond", "gieson-intake"):
        shutil.copy(bench.programs / name, place / name)
    worker = place / "gieson-work"
    worker.write_text(FAKE_WORKER.format(python=sys.executable))
    worker.chmod(0o755)
    (place / "do").write_text(what)
    bench.programs = place


@scenario
def queue(bench):
    """Jobs are worked when they come; a service that stops gives a job back without a death."""
    with_fake_worker(bench, "go on")
    bench.configure(work="Workers=2\n")
    bench.start()
    bench.wait_ready()
    bench.add_specimen("S")
    bench.deliver("S-P1.png", picture(1))
    bench.wait("the jobs", lambda: bench.ask("SELECT count(*) FROM job WHERE state = 'done'") ==
               [(2,)])
    limits = (bench.programs / "limits").read_text()
    demand(re.search(r"Max cpu time\s+\d+", limits), "processor time is limited")
    demand("nice 10" in limits, "it runs in the background")
    (bench.programs / "do").write_text("hang")
    bench.deliver("S-P2.png", picture(2))
    bench.wait("a running job", lambda: bench.ask(
        "SELECT count(*) FROM job WHERE state = 'running'") != [(0,)])
    bench.stop()
    rows = bench.ask("SELECT state, attempts, pid FROM job WHERE state <> 'done'")
    demand(rows and all(row == ("waiting", 0, 0) for row in rows), f"given back: {rows}")


@scenario
def orphaned(bench):
    """A service that is killed gives its jobs no death, however often; a worker that is killed does."""
    place = bench.folder / "bin"
    place.mkdir()
    for name in ("giesond", "gieson-intake", "gieson-work", "gieson-mesh"):
        shutil.copy(bench.programs / name, place / name)
    # A decoder that never ends holds the worker in the middle of its job.
    (place / "gieson-decode").write_text("#!/bin/sh\nexec sleep 600\n")
    (place / "gieson-decode").chmod(0o755)
    made = bench.folder / "S00"
    subprocess.run([bench.programs / "gieson", "phantom", "--specimen", "S00", "--level", "L0", "--seed", "1",
                    "--out", made], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([bench.programs / "gieson", "--store", bench.store, "import", made], check=True,
                   stdout=subprocess.DEVNULL)
    bench.programs = place
    bench.configure(work="Workers=1\n")

    def job():
        rows = bench.ask("SELECT state, stage, attempts, pid FROM job ORDER BY kind, id LIMIT 1")
        return rows[0] if rows else ("", "", 0, 0)

    def held_worker():
        bench.wait("a worker in mid-job", lambda: job()[:2] == ("running", "decoding"))
        return job()[3]

    bench.start()
    for _ in range(7):  # more deaths than a job is given
        worker = held_worker()
        bench.service.kill()
        bench.service.wait()
        end = time.monotonic() + GENEROUS_S
        while os.path.exists(f"/proc/{worker}") and time.monotonic() < end:
            time.sleep(0.02)
        demand(not os.path.exists(f"/proc/{worker}"), "the orphaned worker ended")
        demand(job()[0] == "waiting" and job()[2:] == (0, 0), f"the job was given back: {job()}")
        bench.start()
    for deaths, signal_number in ((0, signal.SIGTERM), (1, signal.SIGKILL), (2, signal.SIGKILL)):
        worker = held_worker()
        os.kill(worker, signal_number)
        bench.wait("another worker", lambda: held_worker() != worker)
        demand(job()[2] == deaths, f"{deaths} deaths are counted: {job()}")


@scenario
def no_mesher(bench):
    """Without gieson-mesh a specimen is held with what to install; panels and other work go on."""
    place = bench.folder / "bin"
    place.mkdir()
    for name in ("giesond", "gieson-intake", "gieson-work", "gieson-decode"):
        shutil.copy(bench.programs / name, place / name)
    made = bench.folder / "S00"
    subprocess.run([bench.programs / "gieson", "phantom", "--specimen", "S00", "--level", "L0", "--seed", "1",
                    "--px", "32", "--out", made], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([bench.programs / "gieson", "--store", bench.store, "import", made], check=True,
                   stdout=subprocess.DEVNULL)
    count = bench.ask("SELECT count(*) FROM job WHERE kind = 'panel'")[0][0]
    bench.programs = place
    bench.configure(work="Workers=1\n")
    bench.start()
    bench.wait("the held specimen", lambda: bench.ask("SELECT 1 FROM job WHERE kind = 'specimen' AND "
                                                      "state = 'failed'"), 180)
    demand(bench.ask("SELECT count(*) FROM job WHERE kind = 'panel' AND state = 'done'") == [(count,)],
           "its panels were registered")
    message, code = bench.ask("SELECT message, code FROM job WHERE state = 'failed'")[0]
    demand(code == "process" and re.match(
        rf"the program gieson-mesh is not installed: there is neither {place}/gieson-mesh nor /\S+/gieson-mesh; "
        r"install gieson again .*, then `gieson retry`$", message), f"{code}: {message}")


@scenario
def job_late(bench):
    """A job that outlives TimeMinutes is ended and fails with a sentence."""
    with_fake_worker(bench, "hang")
    bench.configure(work="TimeMinutes=1\n")
    bench.start()
    bench.wait_ready()
    bench.add_specimen("S")
    bench.deliver("S-P1.png", picture(1))
    bench.wait("the failed job", lambda: bench.ask(
        "SELECT count(*) FROM job WHERE state = 'failed'") != [(0,)], 180)
    message, code = bench.ask("SELECT message, code FROM job WHERE state = 'failed'")[0]
    demand("limit of 1 minutes of time" in message and code == "process", message)


# ---- what systemd and its journal hear --------------------------------------------------------

@scenario
def notifies(bench):
    """READY, STATUS in words, WATCHDOG and STOPPING arrive at systemd's socket."""
    address = str(bench.folder / "notify")
    heard = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address)
        end.settimeout(GENEROUS_S)
        bench.environment["NOTIFY_SOCKET"] = address
        bench.environment["WATCHDOG_USEC"] = "1000000"
        bench.configure(more=f"[source lost]\nAddress=hot:{bench.folder}/nowhere\n")
        bench.start()

        def listen_for(text):
            while not any(text in message for message in heard):
                heard.append(end.recv(4096).decode())
        listen_for("READY=1")
        listen_for("STATUS=1 source ready, 1 away; no jobs waiting")
        listen_for("WATCHDOG=1")
        bench.stop()
        listen_for("STOPPING=1")


@scenario
def journal(bench):
    """With the journal behind stderr the messages have fields. Needs a place for its socket."""
    place = pathlib.Path("/run/systemd/journal/socket")
    if place.exists() or os.geteuid() != 0:
        print("skipped: a journal's socket can be made only by root where there is none")
        return SKIPPED
    # In a namespace of its own nobody else sees the socket.
    if not os.environ.get("GIESON_IN_NAMESPACE"):
        if subprocess.run(["unshare", "--mount", "true"], check=False).returncode != 0:
            print("skipped: no namespace of its own for mounts can be had here (a chroot?)")
            return SKIPPED
        done = subprocess.run(["unshare", "--mount", "env", "GIESON_IN_NAMESPACE=1", sys.executable,
                               __file__, bench.programs, "journal"], check=False)
        return done.returncode if done.returncode in (0, 1) else SKIPPED
    os.makedirs("/run", exist_ok=True)
    if subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/run"], check=False).returncode != 0:
        print("skipped: no tmpfs can be mounted")
        return SKIPPED
    place.parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(place))
        end.settimeout(GENEROUS_S)
        with open(bench.folder / "stream", "wb") as stream:
            stat = os.fstat(stream.fileno())
            bench.environment["JOURNAL_STREAM"] = f"{stat.st_dev}:{stat.st_ino}"
            bench.configure()
            bench.start("--only", "intake", log=stream)
        bench.wait_ready()
        bench.add_specimen("S")
        bench.deliver("S-P1.png", picture(1))
        fields = {}
        while "GIESON_SCAN" not in fields:
            message = end.recv(65536).decode(errors="replace")
            fields = dict(line.split("=", 1) for line in message.splitlines() if "=" in line)
        demand(fields["GIESON_SOURCE"] == "flatbed" and fields["GIESON_SPECIMEN"] == "S", fields)
        demand(fields["GIESON_SCAN"] == "1" and len(fields["MESSAGE_ID"]) == 32, fields)
        demand(fields["PRIORITY"] == "6" and "S-P1.png" in fields["MESSAGE"], fields)
        bench.stop()
    return 0


@scenario
def rest(bench):
    """At rest the service needs next to nothing."""
    seconds = float(os.environ.get("GIESON_REST_S", "5"))
    is_checked = b"libasan" in subprocess.run(["ldd", bench.programs / "giesond"],
                                              capture_output=True, check=True).stdout
    bench.configure()
    bench.start()
    bench.wait_ready()
    bench.wait("an intake", bench.intake)
    time.sleep(1)

    def ticks(pid):
        fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        return int(fields[11]) + int(fields[12])
    processes = {"giesond": bench.service.pid, "gieson-intake": bench.intake()}
    before = {name: ticks(pid) for name, pid in processes.items()}
    time.sleep(seconds)
    for name, pid in processes.items():
        status = pathlib.Path(f"/proc/{pid}/status").read_text()
        resident = int(re.search(r"VmRSS:\s+(\d+) kB", status).group(1)) / 1024
        peak = int(re.search(r"VmHWM:\s+(\d+) kB", status).group(1)) / 1024
        used = (ticks(pid) - before[name]) / os.sysconf("SC_CLK_TCK")
        print(f"{name}: {resident:.1f} MiB resident (peak {peak:.1f}), {100 * used / seconds:.2f} % of a "
              f"processor over {seconds:.0f} s")
        demand(is_checked or resident <= 20, f"{name} has {resident:.1f} MiB")
        demand(is_checked or used <= 0.01 * seconds + 0.02, f"{name} used {used} s")


def main():
    programs, name = sys.argv[1:3]
    with tempfile.TemporaryDirectory(prefix="gieson-service-") as folder:
        bench = Bench(programs, folder)
        try:
            return SCENARIOS[name](bench) or 0
        finally:
            if sys.exc_info()[0] and bench.log.exists():
                print(bench.words()[-6000:])
            bench.stop()
            for end in bench.ends:
                end()


if __name__ == "__main__":
    sys.exit(main())
