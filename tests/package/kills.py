#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Specimens to deliver while services are killed, and what must be in the store afterwards.

    kills.py deliver ONE FOLDER COUNT    makes COUNT specimens of one, no two panels the same bytes
    kills.py judge SCANS STORE COUNT
"""
import hashlib
import json
import shutil
import sqlite3
import struct
import sys
import zlib
from pathlib import Path


def unlike(picture, text):
    """The same picture in other bytes: with a remark behind its header."""
    body = b"tEXt" + b"Comment\0" + text.encode()
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return picture[:33] + chunk + picture[33:]


def deliver(one, folder, count):
    for number in range(count):
        name = f"K{number:03}"
        made = folder / name
        made.mkdir(parents=True)
        for file in one.iterdir():
            if file.suffix == ".png":
                panel = f"{name}-{file.stem.rsplit('-', 1)[1]}.png"
                (made / panel).write_bytes(unlike(file.read_bytes(), panel))
            elif file.name == "job.json":
                job = json.loads(file.read_text())
                job["specimen"] = name
                (made / file.name).write_text(json.dumps(job))
            elif file.is_file():
                shutil.copy(file, made)


def judge(scans, store, count):
    wrong = []
    db = sqlite3.connect(store / "gieson.db")
    if db.execute("PRAGMA integrity_check").fetchall() != [("ok",)]:
        wrong.append("the database is damaged")
    delivered = {(f.parent.name, hashlib.sha256(f.read_bytes()).hexdigest())
                 for f in scans.glob("*/*.png")}
    taken = db.execute("SELECT s.name, p.sha256 FROM panel p JOIN specimen s "
                       "ON s.id = p.specimen_id").fetchall()
    if len(delivered) < 5 * count:
        wrong.append(f"only {len(delivered)} panels were delivered")
    if set(taken) != delivered:
        wrong.append(f"{len(delivered - set(taken))} panels are lost, "
                     f"{len(set(taken) - delivered)} are from nowhere")
    if len(taken) != len(set(taken)):
        wrong.append(f"{len(taken) - len(set(taken))} panels are doubled")
    for _, sha256 in taken:
        file = store / "objects" / sha256[:2] / sha256[2:]
        if not file.exists() or hashlib.sha256(file.read_bytes()).hexdigest() != sha256:
            wrong.append(f"{file} is not what its name says")
    states = db.execute("SELECT state, count(*) FROM job GROUP BY state").fetchall()
    if [state for state, _ in states] != ["done"]:
        wrong.append(f"jobs: {states}")
    # An import that is killed may leave some panels to the next: then there are two reports, of
    # different material. Two of the same were one job done twice.
    for name, runs in db.execute("SELECT s.name, count(*) FROM run r JOIN specimen s "
                                 "ON s.id = r.specimen_id WHERE r.state IN ('reported', 'withheld') "
                                 "GROUP BY s.id, r.key HAVING count(*) > 1"):
        wrong.append(f"{name} was worked {runs} times from the same material")
    left = [str(f) for f in (store / "objects/tmp").rglob("*") if f.is_file()]
    if left:
        wrong.append(f"half copied: {left}")
    runs = db.execute("SELECT state, count(*) FROM run GROUP BY state").fetchall()
    print(f"{len(taken)} panels of {count} specimens, jobs {states}, runs {runs}, "
          f"{'; '.join(wrong) if wrong else 'nothing lost, doubled or left'}")
    return 1 if wrong else 0


verb, first, second, number = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
sys.exit(deliver(first, second, number) if verb == "deliver" else judge(first, second, number))
