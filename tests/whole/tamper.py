#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What is done to a store behind gieson's back is found, and what is damaged is named.

    tamper.py BIN [--flips N] [--only TEXT]

Each line of tamperings.txt is done to a copy of one small store; so are N flips of one bit at a place
in gieson.db drawn with a fixed seed. Page checksums, chain and seals are computed here a second time,
from their descriptions. Exit 0: all were found and named.
"""
import argparse
import glob
import hashlib
import json
import os
import pathlib
import random
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
JOB = {"specimen": "S01", "study": "GVP-D", "group": "S", "animal": "S1", "px_um": 24, "voxel_um": 48,
       "interval_um": 24, "panels": 2, "layout": [3, 4],
       "markers_um": [[-2050, -1000], [1700, -1500], [-1500, 1300]], "transfer": "linear",
       "region": "region.mhd", "thresholds": [0.5]}
# The box from (171, 406, 24) to (651, 886, 552) um, as a mask in a file of its own.
MASK = """ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
Offset = 195 430 36
ElementSpacing = 48 48 24
DimSize = 10 10 22
ElementType = MET_UCHAR
ElementDataFile = region.raw
"""
ZEROS = "0" * 64


# ---- the formats, from their descriptions -------------------------------------------------------

def page_sum(body):
    """storage/pagesum.c"""
    s1 = s2 = 0
    words = struct.unpack(f"<{len(body) // 4}I", body)
    for a, b in zip(words[::2], words[1::2]):
        s1 = (s1 + a + s2) & 0xffffffff
        s2 = (s2 + b + s1) & 0xffffffff
    return struct.pack("<II", s1, s2) if s1 or s2 else b"\xff" * 8


def pages(database):
    data = database.read_bytes()
    size = struct.unpack(">H", data[16:18])[0]
    assert data[20] == 8 and len(data) % size == 0
    return data, size


def sum_anew(database):
    data, size = pages(database)
    database.write_bytes(b"".join(data[at:at + size - 8] + page_sum(data[at:at + size - 8])
                                  for at in range(0, len(data), size)))


def sums_are_right(database):
    data, size = pages(database)
    return all(data[at + size - 8:at + size] == page_sum(data[at:at + size - 8])
               for at in range(0, len(data), size))


def event_hash(previous, row):
    """storage/audit_log.h"""
    number, when, actor, kind, subject, text = row
    digest = hashlib.sha256()
    for part in (previous, f"{number} {when}", actor, kind, subject, text):
        part = part.encode()
        digest.update(b"%d:" % len(part) + part)
    return digest.hexdigest()


def rows_hash(db, run):
    """storage/audit.c"""
    digest = hashlib.sha256()
    for query in ("SELECT * FROM run WHERE id = ?", "SELECT * FROM measure WHERE run_id = ? ORDER BY id",
                  "SELECT * FROM pose WHERE run_id = ? ORDER BY id",
                  "SELECT * FROM stain_batch WHERE run_id = ? ORDER BY id"):
        for row in db.execute(query, (run,)):
            for value in row:
                if value is None:
                    digest.update(b"n")
                elif isinstance(value, int):
                    digest.update(b"i" + struct.pack("<q", value))
                elif isinstance(value, float):
                    digest.update(b"f" + struct.pack("<d", value))
                else:
                    digest.update(b"t" + struct.pack("<Q", len(value.encode())) + value.encode())
    return digest.hexdigest()


# ---- what is done -------------------------------------------------------------------------------

class Tampered:
    """A copy of the store, and the hand that is at it."""

    def __init__(self, store):
        self.store = store
        self.raw = False

    def database(self, work):
        database = self.store / "gieson.db"
        db = sqlite3.connect(database, isolation_level=None)
        for name, in db.execute("SELECT name FROM sqlite_schema WHERE type = 'trigger'").fetchall():
            db.execute(f"DROP TRIGGER {name}")
        answer = work(db)
        db.close()
        if not self.raw:
            for log in ("gieson.db-wal", "gieson.db-shm"):
                (self.store / log).unlink(missing_ok=True)
            sum_anew(database)
        return answer

    def file(self, pattern):
        found = sorted(p for p in glob.glob(str(self.store / pattern)) if os.path.isfile(p))
        assert found, f"{pattern}: there is no such file"
        path = pathlib.Path(found[-1])
        path.chmod(0o644)
        return path

    def end(self):
        return self.database(lambda db: db.execute(
            "SELECT id, hash FROM event ORDER BY id DESC LIMIT 1").fetchone() or (0, ZEROS))

    def do(self, step):
        verb, _, rest = step.strip().partition(" ")
        getattr(self, "do_" + verb)(rest.strip())

    def do_attach(self, name):
        """Another mask in place of the one the run had: valid, kept as an import keeps it."""
        def work(db):
            sha256, = db.execute("SELECT sha256 FROM attachment WHERE name = ?", (name,)).fetchone()
            bytes_ = bytearray((self.store / "objects" / sha256[:2] / sha256[2:]).read_bytes())
            bytes_[0] = 0
            other = hashlib.sha256(bytes_).hexdigest()
            path = self.store / "objects" / other[:2] / other[2:]
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(bytes_)
            path.chmod(0o444)
            db.execute("UPDATE attachment SET sha256 = ? WHERE name = ?", (other, name))
        self.database(work)

    def do_raw(self, _):
        self.raw = True

    def do_sql(self, statements):
        self.database(lambda db: db.executescript(statements))

    def do_rechain(self, _):
        def work(db):
            previous = ZEROS
            for row in db.execute("SELECT id, time, actor, kind, subject, text FROM event "
                                  "ORDER BY id").fetchall():
                previous = event_hash(previous, row)
                db.execute("UPDATE event SET hash = ? WHERE id = ?", (previous, row[0]))
            # A run remembers where the log ended, too, and is part of its own seal.
            for run, in db.execute("SELECT id FROM run").fetchall():
                first = db.execute("SELECT min(id) FROM event WHERE kind = 'seal' AND subject = ?",
                                   (f"run {run}",)).fetchone()[0]
                db.execute("UPDATE run SET event_head = (SELECT hash FROM event WHERE id = ?) "
                           "WHERE id = ? AND ?", (first - 1 if first else 0, run, bool(first)))
        self.database(work)

    def do_reseal(self, run):
        self.database(lambda db: db.execute(
            "UPDATE event SET text = ? WHERE kind = 'seal' AND subject = ?",
            (rows_hash(db, int(run)), f"run {run}")))

    def do_head(self, _):
        (self.store / "audit.head").write_text("%019d %s\n" % self.end(), encoding="ascii")

    def do_beside(self, run):
        path = self.file(f"reports/*/[0-9a-f]*/audit-{run}.json")
        told = json.loads(path.read_text(encoding="utf-8"))

        def work(db):
            told["rows_sha256"] = rows_hash(db, int(run))
            last = db.execute("SELECT min(id) + 1 FROM event WHERE kind = 'seal' AND subject = ?",
                              (f"run {run}",)).fetchone()[0]
            told["events"], told["head"] = db.execute("SELECT id, hash FROM event WHERE id = ?",
                                                      (last,)).fetchone()
        self.database(work)
        path.write_text(json.dumps(told), encoding="utf-8")

    def do_flip(self, pattern):
        path = self.file(pattern)
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        path.write_bytes(data)

    def do_remove(self, pattern):
        self.file(pattern).unlink()

    def do_append(self, pattern):
        path = self.file(pattern)
        path.write_bytes(path.read_bytes() + b"x")

    def do_truncate(self, pattern):
        path = self.file(pattern)
        path.write_bytes(path.read_bytes()[:-1])

    def do_write(self, rest):
        name, _, text = rest.partition(" ")
        path = self.store / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        yesterday = time.time() - 2 * 86400
        for place in (path, path.parent):
            os.utime(place, (yesterday, yesterday))

    def do_replace(self, rest):
        pattern, old, new = rest.split()
        path = self.file(pattern)
        before = path.read_bytes()
        path.write_bytes(before.replace(old.encode(), new.encode()))
        assert path.read_bytes() != before, f"{old} is not in {path}"

    def do_swap(self, rest):
        one, two = map(self.file, rest.split())
        a, b = one.read_bytes(), two.read_bytes()
        one.write_bytes(b)
        two.write_bytes(a)


# ---- what is found ------------------------------------------------------------------------------

class Bench:
    def __init__(self, bin_folder, folder):
        self.bin = pathlib.Path(bin_folder).resolve()
        self.folder = pathlib.Path(folder)
        self.store = self.folder / "store"
        self.journal = self.folder / "journal"
        self.verified = 0

    def call(self, *args, store=None):
        return subprocess.run([self.bin / "gieson", "--store", store or self.store, *args],
                              capture_output=True, text=True, check=False, timeout=900)

    def must(self, *args):
        done = self.call(*args)
        if done.returncode != 0:
            raise SystemExit(f"{args} ended with {done.returncode}\n{done.stdout}{done.stderr}")
        return done

    def make(self):
        scans = self.folder / "scans"
        self.must("phantom", "--specimen", "S01", "--level", "L0", "--seed", "1", "--px", "24",
                  "--out", str(scans))
        incoming = self.folder / "in"
        incoming.mkdir()
        for number in ("P01", "P02"):
            shutil.copy(scans / f"GVP-D-S01-{number}.png", incoming / f"{number}.png")
        (incoming / "region.mhd").write_text(MASK, encoding="ascii")
        (incoming / "region.raw").write_bytes(b"\1" * (10 * 10 * 22))
        (incoming / "job.json").write_text(json.dumps(JOB), encoding="utf-8")
        self.must("import", str(incoming))
        self.must("run")
        self.must("decide", "S01", "2", "first", "1", "--because", "it begins there")
        self.must("run")
        # Alone with the store, it copies what is in SQLite's log into the database when it ends.
        self.must("scrub", "--quick")
        for log in ("gieson.db-wal", "gieson.db-shm"):
            (self.store / log).unlink()

    def found(self, store, named):
        """scrub, then verify, then with the journal: what they say, and who found it; None: nobody."""
        said = ""
        asked = [("scrub", "--quick"), ("scrub",), ("verify", "S01")]
        if self.journal.exists():
            asked.append(("scrub", "--quick", "--journal", str(self.journal)))
        for args in asked:
            self.verified += args[0] == "verify"
            done = self.call(*args, store=store)
            said += done.stdout + done.stderr
            if done.returncode != 0 and re.search(named, said, re.DOTALL):
                return " ".join(args[:3]), said
            if done.returncode < 0:
                raise SystemExit(f"{args} was killed by signal {-done.returncode}\n{said}")
        return None, said


def cases(only):
    for line in (HERE / "tamperings.txt").read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            name, named, steps = re.split(r"\s+\|\s+", line, maxsplit=2)
            if only in name:
                yield name, named, steps.split("&&")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin")
    parser.add_argument("--flips", type=int, default=50)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(args.bin, folder)
        bench.make()
        whole, said = bench.found(bench.store, "")
        if whole or not sums_are_right(bench.store / "gieson.db"):
            raise SystemExit(f"the store was not whole before anything was done to it:\n{said}")
        # The line that a worker leaves in the system's journal; here is none.
        events, head = (bench.store / "audit.head").read_text(encoding="ascii").split()
        bench.journal.write_text(f"gieson-work[1]: audit log: {int(events)} events, head {head}\n",
                                 encoding="utf-8")
        copy = pathlib.Path(folder) / "copy"
        done, by = 0, {}
        for name, named, steps in cases(args.only):
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(bench.store, copy)
            tampered = Tampered(copy)
            for step in steps:
                tampered.do(step)
            who, said = bench.found(copy, named)
            done += 1
            by[who] = by.get(who, 0) + 1
            print(f"{'found by ' + who if who else 'NOT FOUND':28} {name}", flush=True)
            if not who:
                missed.append(f"{name} (to be named: {named})\n{said}")
        draw = random.Random(24)
        flipped = 0
        for i in range(args.flips):
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(bench.store, copy)
            database = copy / "gieson.db"
            data = bytearray(database.read_bytes())
            at, bit = draw.randrange(len(data)), draw.randrange(8)
            data[at] ^= 1 << bit
            database.write_bytes(data)
            who, said = bench.found(copy, r"gieson\.db")
            flipped += who is not None
            if not who:
                missed.append(f"flip {i}: bit {bit} of byte {at} (page {at // 4096 + 1})\n{said}")
        print(f"{done - sum(m[:4] != 'flip' for m in missed)} of {done} tamperings found "
              f"({', '.join(f'{who}: {n}' for who, n in by.items())}), "
              f"{flipped} of {args.flips} flipped bits; verify was needed {bench.verified} times")
    for what in missed:
        print(f"NOT FOUND: {what}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
