# SPDX-License-Identifier: AGPL-3.0-or-later
"""A store as a busy bench leaves it, written row by row, and a terminal to look at it."""
import os
import pathlib
import shutil
import sqlite3
import subprocess
import time
import uuid

DIGEST = "{:064x}"
SECONDS = 20  # how long something may take to appear before a test fails


class Scene:
    """Rows in a store; all times are ages in seconds."""

    def __init__(self, database):
        self.db = sqlite3.connect(database, isolation_level=None, timeout=30)
        self.now = int(time.time())
        self.digests = 0

    def close(self):
        self.db.close()

    def run(self, sql, *values):
        return self.db.execute(sql, values).lastrowid

    def digest(self):
        self.digests += 1
        return DIGEST.format(self.digests)

    def specimen(self, name, group="treated", baseline=""):
        study = self.one("study", "INSERT OR IGNORE INTO study (name) VALUES ('debris')",
                         "SELECT id FROM study WHERE name = 'debris'")
        group = self.one("group", "INSERT OR IGNORE INTO study_group (study_id, name) "
                         "VALUES (?, ?)", "SELECT id FROM study_group WHERE study_id = ? AND "
                         "name = ?", study, group)
        animal = self.one("animal", "INSERT OR IGNORE INTO animal (study_id, name) VALUES (?, ?)",
                          "SELECT id FROM animal WHERE study_id = ? AND name = ?", study, name)
        return self.run("INSERT INTO specimen (name, study_id, group_id, animal_id, kind, "
                        "baseline, job_json, job_sha256) VALUES (?, ?, ?, ?, 'sections', ?, '{}', "
                        "?)", name, study, group, animal, baseline, DIGEST.format(0))

    def one(self, _, insert, select, *values):
        self.db.execute(insert, values)
        return self.db.execute(select, values).fetchone()[0]

    def panel(self, specimen, number, state="registered", message="", age=None, source="scanner",
              name=None):
        digest, name = self.digest(), name or f"P{number:02}.tif"
        panel = self.run("INSERT INTO panel (specimen_id, number, file_name, sha256, size, state, "
                         "code, message, width, height) VALUES (?, ?, ?, ?, 1000000, ?, '', ?, 0, "
                         "0)", specimen, number, name, digest, state, message)
        if age is not None:
            self.scan(source, name, digest=digest, state="filed", panel=panel, age=age)
        return panel

    def scan(self, source, name, digest=None, state="unfiled", reason="", panel=None, age=0,
             size=28_000_000):
        return self.run("INSERT INTO scan (source, device, name, key, subject, sha256, size, "
                        "facts, state, reason, panel_id, arrived) VALUES (?, '', ?, '', 'panel', "
                        "?, ?, '', ?, ?, ?, ?)", source, name, digest or self.digest(), size,
                        state, reason, panel, self.now - age)

    def arrival(self, source, name, size=28_000_000):
        """A picture that is safe and was not settled, as a service that was killed leaves it."""
        return self.run("INSERT INTO inbox (size, sha256, name, source, device, key, subject, "
                        "facts, number, arrived) VALUES (?, ?, ?, ?, '', '', 'panel', '', 0, ?)",
                        size, self.digest(), name, source, self.now)

    def job(self, specimen, panel=None, state="waiting", stage="", done=0, total=0, left=None,
            message=""):
        return self.run("INSERT INTO job (kind, specimen_id, panel_id, state, stage, done, total, "
                        "eta_s, message) VALUES (iif(?2 IS NULL, 'specimen', 'panel'), ?1, ?2, "
                        "?3, ?4, ?5, ?6, ?7, ?8)", specimen, panel, state, stage, done, total,
                        left, message)

    def ran(self, specimen, state="reported", loss=None, message="", age=0):
        run = self.run("INSERT INTO run (specimen_id, key, version, inputs_json, parameters_json, "
                       "state, message, report_path, started, finished) VALUES (?, ?, '1', '{}', "
                       "'{}', 'running', ?, 'reports/r/report.html', ?, ?)", specimen,
                       self.digest(), message, self.now - age, self.now - age)
        if loss is not None:
            self.run("INSERT INTO measure (run_id, name, value, unit) VALUES (?, 'loss', ?, '%')",
                     run, loss)
        self.run("UPDATE run SET state = ? WHERE id = ?", state, run)
        return run

    def source(self, name, address, state, message="", item="", done=0, total=0, age=0,
               device=""):
        self.run("INSERT OR REPLACE INTO source VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", name, address,
                 device, state, message, item, done, total, self.now - age)

    def trouble(self, source, name, reason, action, tries=1, age=0):
        self.run("INSERT INTO trouble VALUES (?, ?, ?, ?, ?, ?, ?)", source, name, reason, action,
                 tries, self.now - age, self.now - age)

    def expects(self, source, specimen):
        self.run("INSERT OR REPLACE INTO expectation VALUES (?, ?, 'Anna', ?)", source, specimen,
                 self.now)

    def busy_bench(self):
        """Everything that the screen can show, once. Ages stand in the middle of their minute."""
        s00 = self.specimen("GVP-D-S00", "saline")
        for number in range(1, 6):
            self.panel(s00, number, age=26 * 3600)
        self.ran(s00, age=25 * 3600)
        s01 = self.specimen("GVP-D-S01", baseline="saline")
        for number in range(1, 5):
            self.panel(s01, number, age=3 * 3600 + 100)
        self.panel(s01, 5, "refused", "P05.tif: the file ends in the middle of strip 12: scan it "
                   "again", age=3 * 3600 + 100)
        self.ran(s01, loss=31.42, age=2 * 3600 + 30)
        s02 = self.specimen("GVP-D-S02", baseline="saline")
        for number in range(1, 4):
            self.panel(s02, number, age=300 + 10)
        self.job(s02, self.panel(s02, 4, "waiting", age=120 + 10), "running", "decode", 2, 5, 12.0)
        self.job(s02, self.panel(s02, 5, "waiting", age=60 + 10))
        self.job(s02)
        s03 = self.specimen("GVP-D-S03", baseline="saline")
        self.panel(s03, 1, age=40 * 60 + 10)
        self.job(s03, None, "failed", message="no mesh could be made of region.mhd: its surface "
                 "is open at 3 edges; draw the region again and import it")
        s04 = self.specimen("Gelenk-\u00dc7 links", baseline="saline")
        self.panel(s04, 1, age=50 * 60 + 10)
        self.job(s04, None, "running", "fit", 40, 100, 640.0)
        s05 = self.specimen("R07-left")
        self.ran(s05, "withheld", message="only 2 of 60 sections carry all three marks", age=86400 * 9)
        self.source("copystand", "ptp:04a9:3219", "receiving", item="IMG_0042.JPG",
                    done=12_040_000, total=28_000_000, age=10)
        self.source("scanner", "hot:/srv/scans", "ready", age=7 * 60 + 10)
        self.source("microscope", "v4l2:usb-cam-7", "away",
                    "no device with serial 7 is plugged in", age=2 * 3600 + 30)
        self.expects("scanner", s02)
        self.trouble("scanner", "P09.tif", "P09.tif is not whole after 60 s: its last strip is "
                     "missing", "look at the scanner; a whole file is taken by itself", 3,
                     age=5 * 60 + 10)
        self.scan("copystand", "IMG_0041.JPG", reason="no specimen's name begins its name",
                  age=4 * 60 + 10)


class Tmux:
    """A terminal of its own; everything it needs ends with it."""

    def __init__(self, columns, rows, command, environment, folder, utf8=True, term=None):
        self.socket = f"gieson-{uuid.uuid4().hex}"
        config = pathlib.Path(folder) / "tmux.conf"
        config.write_text(f"set -g default-terminal {term or 'tmux-256color'}\n"
                          "set -g status off\nset -sg escape-time 0\nset -g remain-on-exit on\n",
                          encoding="utf-8")
        self.environment = {**environment, "LC_ALL": "C.UTF-8", "TMUX_TMPDIR": str(folder)}
        self.status = pathlib.Path(folder) / f"{self.socket}.status"
        locale = "C.UTF-8" if utf8 else "C"
        # Not every end of a pane is told by tmux, so the shell keeps it.
        self.tmux("-f", str(config), "new-session", "-d", "-x", str(columns), "-y", str(rows),
                  "-c", str(folder), f"trap : INT; LC_ALL={locale} {command}; "
                  f"echo $? >{self.status.name}.new; mv {self.status.name}.new {self.status.name}")

    def tmux(self, *args):
        done = subprocess.run(["tmux", "-u", "-L", self.socket, *args], env=self.environment,
                              capture_output=True, encoding="utf-8", check=False, timeout=60)
        if done.returncode != 0:
            raise AssertionError(f"tmux {args[0]}: {done.stderr}")
        return done.stdout

    def screen(self, escapes=False):
        """What stands there, without blanks at the ends of lines."""
        text = self.tmux("capture-pane", "-p", *(["-e"] if escapes else []))
        return "\n".join(line.rstrip() for line in text.split("\n")).rstrip("\n") + "\n"

    def wait_for(self, is_there, what="it"):
        """The screen as soon as it is so, and twice the same."""
        end = time.monotonic() + SECONDS
        before = None
        while time.monotonic() < end:
            now = self.screen()
            if now == before and is_there(now):
                return now
            before = now
            time.sleep(0.05)
        raise AssertionError(f"{what} did not appear in {SECONDS} s:\n{before}")

    def wait_for_text(self, text):
        return self.wait_for(lambda screen: text in screen, repr(text))

    def press(self, *keys):
        self.tmux("send-keys", *keys)

    def resize(self, columns, rows):
        self.tmux("resize-window", "-x", str(columns), "-y", str(rows))

    def ended(self):
        """Its exit status, or None while it runs."""
        return int(self.status.read_text("ascii")) if self.status.exists() else None

    def wait_for_end(self):
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            if self.ended() is not None:
                return self.ended()
            time.sleep(0.05)
        raise AssertionError(f"it did not end:\n{self.screen()}")

    def pid(self):
        """Of the program, which is the shell's child."""
        shell = self.tmux("display-message", "-p", "#{pane_pid}").strip()
        return int(pathlib.Path(f"/proc/{shell}/task/{shell}/children").read_text("ascii"))

    def close(self):
        subprocess.run(["tmux", "-L", self.socket, "kill-server"], env=self.environment,
                       capture_output=True, check=False, timeout=60)


def has_tmux():
    return shutil.which("tmux") is not None and os.access("/dev/ptmx", os.R_OK)
