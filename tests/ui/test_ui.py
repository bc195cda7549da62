#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""gieson as a person or a script meets it.

    test_ui.py BIN [TOPIC [test]]      BIN is the folder with the programs
"""
import hashlib
import json
import os
import pathlib
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import bench  # noqa: E402
from bench import Bench, columns, png  # noqa: E402
from scene import Scene  # noqa: E402

MANUAL = pathlib.Path(__file__).resolve().parents[2] / "docs" / "man" / "gieson.1"

# What `gieson status --json` and `gieson show --json` promise; the manual page names every key.
ROOT_KEYS = {"queue", "service", "sources", "troubles", "unsettled", "unfiled", "specimens"}
STATUS_KEYS = {"specimen", "group", "state", "detail", "action", "panels", "panels_registered",
               "panels_refused", "sections", "sections_found", "loss_percent", "loss_lower",
               "loss_upper", "mean_density",
               "run", "report"}
SHOW_KEYS = {"specimen", "kind", "group", "baseline", "delivered_by", "panels", "sections", "runs",
             "measures"}
PANEL_KEYS = {"number", "file", "sha256", "state", "code", "message", "action"}
RUN_KEYS = {"run", "state", "message", "key", "version", "event_head"}

ODD_NAMES = ["x" * 1000, "Gelenk Ü 7 \u6d4b\u8bd5", "e\u0301" * 30, "\u6d4b" * 60, "two\nlines",
             "red \x1b[31m\x1b]0;title\x07", "it's $HOME `id` \"q\"", "--json-like", "a%sb%n",
             "tab\tand\x7fdelete", "\u202eturned"]


class Words(Bench):
    """Mistakes on the command line: 64, one line that names it."""

    def test_a_refused_word_is_told_with_its_verb(self):
        self.empty_store()
        for verb in ("run", "night"):
            self.assertEqual(self.call(verb, "more").stderr,
                             f'gieson: {verb} takes only --threads N{" and --slurm" if verb == "night" else ""}, '
                             'not "more"\n')

    def test_a_mistake_is_one_line_and_64(self):
        self.empty_store()
        for args in ([], ["frobnicate"], [""], ["status", "more"], ["top", "more"], ["top", "--json"], ["show"], ["show", "a", "b"],
                     ["report"], ["import"], ["verify"], ["check"], ["run", "--threads"],
                     ["run", "more"], ["retry", "a", "b"], ["demo", "a", "b"], ["night", "more"], ["night", "--share"], ["night", "--rest", "{}"],
                     ["night", "--threads"], ["scrub", "--minutes"], ["scrub", "--minutes", "x"],
                     ["scrub", "--quickly"], ["backup"], ["backup", "a", "b"], ["restore"],
                     ["verify", "--journal", "x"],
                     ["file"], ["file", "1", "S"], ["file", "x", "S", "--panel", "1"],
                     ["file", "1", "S", "--panel", "0"], ["file", "1", "S", "--panel", "-1"],
                     ["file", "1", "S", "T", "--panel", "1"], ["expect", "cam"],
                     ["expect", "cam", "S", "T"], ["capture"], ["capture", "cam", "--red"],
                     ["check-config", "a", "b"], ["register"], ["decide"], ["decide", "S", "1.1"],
                     ["decide", "S", "1", "cut"], ["decide", "S", "1.1", "lost"],
                     ["decide", "S", "1.1", "perhaps"], ["decide", "S", "1.1", "slot", "x"],
                     ["decide", "S", "x.1", "cut"], ["decide", "S", "1.0", "cut"],
                     ["decide", "S", "1.1", "cut", "more"],
                     ["status", "--store"]):
            with self.subTest(args=args):
                self.refused(self.call(*args), 64)

    def test_the_unknown_verb_is_named(self):
        self.assertIn('"frobnicate"', self.refused(self.call("frobnicate"), 64))

    def test_an_unknown_option_is_64_and_silent_on_stdout(self):
        done = self.call("--frobnicate", store=False)
        self.assertEqual((done.returncode, done.stdout), (64, ""))
        self.assertIn("--frobnicate", done.stderr)

    def test_help_names_every_verb_and_version_is_a_version(self):
        done = self.call("--help", store=False)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        for verb in re.findall(r"^  ([a-z][a-z-]*) ", done.stdout, re.M):
            page = self.call(verb, "--help", store=False)
            self.assertEqual(page.returncode, 0, verb)
            self.assertIn("usage: ", page.stdout.lower())
            if verb != "phantom":
                self.assertRegex(page.stdout, rf"(?s)usage: gieson {verb}.*Example:\n  .*gieson {verb}")
        for verb in ("import", "run", "night", "status", "top", "show", "report", "retry",
                     "verify", "scrub", "backup", "restore", "check", "demo", "phantom", "file", "expect", "capture",
                     "check-config", "devices", "register", "decide"):
            self.assertRegex(done.stdout, rf"(?m)^ +{verb}\b")
        done = self.call("--version", store=False)
        self.assertEqual(done.returncode, 0)
        self.assertRegex(done.stdout, r"^gieson \d+\.\d+\.\d+\n$")


class Stores(Bench):
    """Where the store is, and what when it is not."""

    def test_no_store_named_is_64(self):
        for args in (["status"], ["top"], ["show", "x"], ["report", "x"], ["run"], ["retry"],
                     ["import", "x"], ["verify", "1"], ["night"], ["scrub"], ["expect", "a", "b"],
                     ["file", "1", "s", "--panel", "1"], ["capture", "cam"], ["backup", "x"],
                     ["restore", "x"]):
            with self.subTest(args=args):
                self.assertIn("GIESON_STORE", self.refused(self.call(*args, store=False), 64))
        self.refused(self.call("status", store=False, env={"GIESON_STORE": ""}), 64)

    def test_a_store_that_is_not_there_is_66_and_is_not_made(self):
        for args in (["status"], ["status", "--json"], ["top"], ["show", "x"], ["report", "x"], ["run"],
                     ["retry"], ["verify", "1"], ["night"], ["scrub"], ["expect", "a", "b"],
                     ["file", "1", "s", "--panel", "1"], ["capture", "cam"]):
            with self.subTest(args=args):
                self.assertIn("is not a gieson store", self.refused(self.call(*args), 66))
        self.assertFalse(self.store.exists())
        self.store.write_text("a file")
        self.refused(self.call("status"), 66)

    def test_an_empty_store_says_what_to_do(self):
        self.empty_store()
        done = self.call("status")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertIn("0 waiting", done.stdout)
        self.assertIn("gieson import", done.stdout)
        self.assertEqual(self.json("status"),
                         {"queue": {"waiting": 0, "running": 0, "done": 0, "failed": 0},
                          "service": {"intake": False, "works_queue": False}, "sources": [],
                          "troubles": [], "unsettled": 0, "unfiled": [], "specimens": []})

    def test_the_store_may_be_named_before_and_after_the_verb_and_by_the_environment(self):
        self.imported("here")
        there = str(self.store)
        nowhere = str(self.folder / "nowhere")
        for args, env in ((["--store", there, "status"], {}), (["-s", there, "status"], {}),
                          (["--store=" + there, "status"], {}),
                          (["status", "--store", there], {}), (["status", "--store=" + there], {}),
                          (["status"], {"GIESON_STORE": there}),
                          (["status", "--store", there], {"GIESON_STORE": nowhere}),
                          (["--store", nowhere, "status", "--store", there], {})):
            with self.subTest(args=args, env=env):
                done = self.call(*args, store=False, env=env)
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn("here", done.stdout)

    def test_another_programs_database_a_newer_one_and_junk_are_refused(self):
        self.empty_store()
        database = self.store / "gieson.db"
        with sqlite3.connect(database) as db:
            db.execute("PRAGMA user_version = 99")
        db.close()
        self.assertIn("newer", self.refused(self.call("status"), 65))
        with sqlite3.connect(database) as db:
            db.execute("PRAGMA application_id = 7")
        db.close()
        self.assertIn("another program", self.refused(self.call("status"), 74))
        for rest in self.store.glob("gieson.db-*"):
            rest.unlink()
        database.write_bytes(b"no database at all" * 1000)
        self.refused(self.call("status"), 74)

    def test_what_is_advised_names_the_store_that_the_command_named(self):
        self.imported("one")
        there = str(self.store)
        for args in (["status"], ["status", "--json"], ["top"], ["retry"],
                     ["import", self.job("two", folder="b")],
                     # sentences of gieson, of the store and of gieson-work
                     ["status", "x"], ["report"], ["decide", "one"], ["file", "1"],
                     ["show", "nobody"], ["report", "one"], ["file", "9", "one"], ["expect", "x", "one"],
                     ["import", self.job("one", study="other", folder="c")], ["verify", "one"],
                     ["verify", "nobody"]):
            with self.subTest(args=args):
                said = self.call("--store", there, *args, store=False)
                said = said.stdout + said.stderr
                advised = re.findall(r"(?:`|next: |  |\")gieson [^`\n]*", said)
                self.assertGreater(len(advised), 0, said)
                for command in advised:
                    self.assertIn(f"gieson --store {there} ", command)
                again = self.call(*args)
                self.assertNotIn("--store", again.stdout + again.stderr)

    def test_what_is_not_in_the_store_is_66(self):
        self.imported("here")
        for args in (["show", "nobody"], ["report", "nobody"], ["retry", "nobody"],
                     ["verify", "nobody"], ["verify", "99"], ["report", "here"], ["show", ""]):
            for late in ([], ["--json"]):
                with self.subTest(args=args + late):
                    self.refused(self.call(*args, *late), 66)


class Plain(Bench):
    """What scripts read."""

    def test_a_pipe_gets_plain_text_and_a_terminal_colour(self):
        self.imported("one")
        self.reported_tile()
        for args in (["status"], ["show", "one"], ["report", "tile"], ["status", "--json"]):
            done = self.call(*args)
            self.assertNotIn("\x1b", done.stdout + done.stderr)
        self.assertIn("\x1b[32m", self.terminal(100, "status")[1])
        self.assertIn("\x1b[32m", self.terminal(100, "status", env={"NO_COLOR": ""})[1])
        code, screen = self.terminal(100, "status", env={"NO_COLOR": "1"})
        self.assertEqual(code, 0)
        self.assertNotIn("\x1b", screen)
        self.assertNotIn("\x1b", self.terminal(100, "status", "--json")[1])

    def test_state_is_a_word_and_a_symbol_and_not_only_a_colour(self):
        self.imported("one")
        self.assertRegex(self.call("status").stdout, r"(?m)^\. one +.* waiting ")

    def test_json_has_the_documented_keys(self):
        self.imported("one", group="G")
        self.reported_tile()
        root = self.json("status")
        self.assertEqual(set(root), ROOT_KEYS)
        self.assertEqual(set(root["queue"]), {"waiting", "running", "done", "failed"})
        for row in root["specimens"]:
            self.assertEqual(set(row), STATUS_KEYS)
        row = next(r for r in root["specimens"] if r["specimen"] == "one")
        self.assertEqual((row["group"], row["state"], row["panels"]), ("G", "withheld", 1))
        shown = self.json("show", "one")
        self.assertEqual(set(shown), SHOW_KEYS)
        self.assertEqual(set(shown["panels"][0]), PANEL_KEYS)
        self.assertEqual(set(shown["runs"][0]), RUN_KEYS)
        manual = MANUAL.read_text(encoding="utf-8")
        for key in ROOT_KEYS | STATUS_KEYS | SHOW_KEYS | PANEL_KEYS | RUN_KEYS | set(root["queue"]):
            self.assertRegex(manual, rf"\b{key}\b", f"the manual does not name {key}")

    def test_the_report_is_that_of_the_file(self):
        self.reported_tile()
        lines = self.call("report", "tile").stdout.splitlines()
        self.assertEqual(len(lines), 4)
        self.assertTrue(pathlib.Path(lines[1]).is_file() and lines[1].endswith(".html"))
        self.assertTrue(lines[3].endswith("/report.pdf"))
        self.assertTrue(pathlib.Path(lines[3]).read_bytes().startswith(b"%PDF-"))
        told = self.call("report", "tile", "--json").stdout
        self.assertEqual(told, pathlib.Path(lines[2]).read_text(encoding="utf-8"))
        for key in ("specimen", "baseline", "loss_percent", "region", "volumes", "sections"):
            self.assertIn(key, json.loads(told))

    def test_a_trace_names_files_hashes_and_what_changed(self):
        self.reported_tile()
        picture = (self.folder / "tile.png").read_bytes()
        first = self.json("trace", "tile")
        digest = hashlib.sha256(picture).hexdigest()
        self.assertIn(("tile.png", digest), [(f["name"], f["sha256"]) for f in first["inputs"]])
        self.assertEqual((first["run"], first["compared_with_run"], first["changes"]), (1, None, []))
        told = self.call("trace", "tile").stdout
        self.assertIn(f"from tile.png, sha256 {digest}\n", told.replace("\n    ", " "))
        self.assertRegex(told, r"^tile: no loss; run 1 of \d{4}-\d\d-\d\d, gieson \S+, key [0-9a-f]{8}\n")
        png(self.folder / "tile.png", seed=4)
        self.assertEqual(self.call("import", "--replace", "--tile", str(self.folder / "tile.png"))
                         .returncode, 0)
        self.assertEqual(self.call("run").returncode, 0)
        again = self.json("trace", "tile")
        now = hashlib.sha256((self.folder / "tile.png").read_bytes()).hexdigest()
        self.assertEqual((again["run"], again["compared_with_run"]), (2, 1))
        self.assertIn(f"file tile.png: {now}, was {digest}", again["changes"])
        self.assertIn("against run 1:\n", self.call("trace", "tile").stdout)
        path = pathlib.Path(self.call("report", "tile").stdout.splitlines()[2])
        path.write_bytes(path.read_bytes().replace(b"tile", b"tale"))
        self.assertIn("not those that the run wrote", self.refused(self.call("trace", "tile"), 65))

    def test_a_study_is_traced_to_its_animals(self):
        self.imported("one")
        self.assertIn("no specimen and no study", self.refused(self.call("trace", "none"), 66))
        place = self.job("one", study="s1", animal="A7")
        self.assertEqual(self.call("import", "--replace", place).returncode, 0)
        self.assertEqual(self.call("trace", "s1").stdout,
                         "animal A7, specimen one: has no report yet\n")
        self.call("run")
        self.assertRegex(self.call("trace", "s1").stdout.replace("\n    ", " "),
                         r"^animal A7, specimen one: run 1, report.json [0-9a-f]{64}: "
                         r"`gieson trace one`\n$")

    def test_verify_says_that_the_bytes_are_the_same(self):
        self.reported_tile()
        told = self.json("verify", "tile")
        self.assertTrue(told["verified"] and told["audit_log_whole"])
        self.assertEqual(told["findings"], [])

    def test_a_report_that_is_not_what_the_run_wrote_is_not_shown_and_verify_names_it(self):
        self.reported_tile()
        html, text = map(pathlib.Path, self.call("report", "tile").stdout.splitlines()[1:3])
        for path in (html, text):
            content = path.read_bytes()
            path.write_bytes(content.replace(b"tile", b"tale"))
            for args in (["report", "tile"], ["report", "tile", "--json"]):
                done = self.refused(self.call(*args), 65)
                self.assertIn(f"{path}: its bytes are not those that the run wrote; it is not shown. "
                              "`gieson verify 1` says what else changed", done)
            self.assertEqual([f["what"] for f in self.json("verify", "tile", code=1)["findings"]],
                             [str(path.relative_to(self.store))])
            self.assertRegex(self.call("verify", "tile").stdout,
                             rf"^run 1: NOT the same:\n  .*{path.name}: .*not those that the run wrote")
            path.write_bytes(content)
        self.assertEqual(self.call("report", "tile", "--json").returncode, 0)

    def test_a_pdf_that_is_not_what_the_run_wrote_is_not_shown_and_verify_names_it(self):
        self.reported_tile()
        path = pathlib.Path(self.call("report", "tile").stdout.splitlines()[3])
        content = path.read_bytes()
        path.write_bytes(content.replace(b"cairo", b"Cairo"))
        self.assertIn(f"{path}: its bytes are not those that the run wrote",
                      self.refused(self.call("report", "tile"), 65))
        self.assertIn(str(path.relative_to(self.store)),
                      [f["what"] for f in self.json("verify", "tile", code=1)["findings"]])
        path.write_bytes(content)
        self.assertTrue(self.json("verify", "tile")["verified"])

    def test_verify_compares_with_the_lines_of_the_journal(self):
        self.reported_tile()
        number, head = (self.store / "audit.head").read_text(encoding="ascii").split()
        journal = self.folder / "journal"
        line = "Nov 25 05:00:00 bench gieson-work[7]: audit log: {} events, head {}\n"
        journal.write_text("Nov 25 05:00:00 bench kernel: hello\n" + line.format(int(number), head),
                           encoding="utf-8")
        self.assertTrue(self.json("verify", "--journal", str(journal), "tile")["verified"])
        journal.write_text(line.format(int(number) + 1, head), encoding="utf-8")
        done = self.call("verify", "--journal", str(journal), "tile")
        self.assertEqual(done.returncode, 1)
        self.assertIn(f"audit log: its newest events are gone: by the journal there were "
                      f"{int(number) + 1}", done.stdout)
        with open(journal, encoding="utf-8") as lines:  # as journalctl ... | gieson verify ...
            piped = self.call("verify", "--journal", "-", "tile", stdin=lines)
        self.assertEqual((piped.returncode, piped.stdout), (done.returncode, done.stdout))
        self.assertEqual(self.call("scrub", "--quick", "--journal", str(journal)).returncode, 65)
        journal.write_text("nothing\n", encoding="utf-8")
        self.assertIn("journalctl -t gieson-work", self.refused(
            self.call("verify", "--journal", str(journal), "tile"), 65))


class Names(Bench):
    """Names are data: any text, of any length."""

    def import_all(self):
        for i, name in enumerate(ODD_NAMES):
            self.imported(name, folder=f"scans{i}")

    def test_a_name_beyond_a_thousand_bytes_is_refused(self):
        self.refused(self.call("import", self.job("x" * 1001)), 65)
        self.refused(self.call("show", "x" * 100000), 66)

    def test_every_name_survives_the_way_through_json(self):
        self.import_all()
        self.assertEqual([r["specimen"] for r in self.json("status")["specimens"]], ODD_NAMES)
        for name in ODD_NAMES:
            self.assertEqual(self.json("show", name)["specimen"], name)

    def test_nothing_in_a_name_reaches_the_terminal_as_a_command(self):
        self.import_all()
        done = self.call("status")
        self.assertEqual(len(done.stdout.splitlines()), 2 + len(ODD_NAMES))
        code, screen = self.terminal(200, "status", env={"NO_COLOR": "1"})
        self.assertEqual(code, 0)
        texts = [done.stdout, screen] + [self.call("show", n).stdout for n in ODD_NAMES]
        texts += [self.call("show", n + "\x1b[31m\n").stderr for n in ODD_NAMES[1:]]
        for text in texts:
            self.assertNotRegex(text, r"[\x00-\x09\x0b-\x1f\x7f]")

    def test_a_name_moves_no_cursor(self):
        place = self.job("odd")
        png(place + "/\x1b[2J\x9b31m_P02.png", 8, 8)
        for args in (["import", place], ["check", place + "/\x1b[2J\x9b31m_P02.png"],
                     ["check", "\x1b[2J"], ["show", "\x1b[2J"], ["import", "\x1b[2J"],
                     ["check-config", "\x1b[2J"], ["register", "\x1b[2J"]):
            with self.subTest(args=args):
                done = self.call(*args)
                self.assertNotIn("\x1b", done.stdout + done.stderr)
                self.assertNotIn("\x9b", done.stdout + done.stderr)

    def test_a_complaint_about_a_name_is_one_line(self):
        self.empty_store()
        for name in ODD_NAMES:
            with self.subTest(name=name[:20]):
                done = self.call("show", name)
                self.assertEqual((done.returncode, done.stderr.count("\n")), (66, 1))

    def test_the_next_command_can_be_pasted_into_a_shell(self):
        self.import_all()
        self.assertEqual(self.call("run").returncode, 65)  # all withheld
        for row in self.json("status")["specimens"]:
            self.assertTrue(row["action"].startswith("gieson show "), row["action"])
            env = self.environment(GIESON_STORE=str(self.store),
                                   PATH=f"{bench.BIN}:{os.environ['PATH']}")
            done = bench.subprocess.run(["sh", "-c", row["action"] + " --json"], env=env,
                                        capture_output=True, encoding="utf-8", check=False)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(json.loads(done.stdout)["specimen"], row["specimen"])

    def test_a_file_name_that_is_no_utf8_does_not_drop_its_row(self):
        place = os.fsencode(self.job("odd"))
        png(place + b"/caf\xe9_P02.png", 32, 32, seed=9)
        self.assertEqual(self.call("import", os.fsdecode(place)).returncode, 0)
        files = [p["file"] for p in self.json("show", "odd")["panels"]]
        self.assertEqual(sorted(files), ["caf\ufffd_P02.png", "scan_P01.png"])
        self.assertIn("caf?_P02.png", self.call("show", "odd").stdout)


class Check(Bench):
    """`gieson check` needs no store."""

    def check(self, *files):
        return self.call("check", *map(str, files), store=False)

    def test_a_good_picture_is_fine(self):
        png(self.folder / "good.png", 40, 30)
        done = self.check(self.folder / "good.png")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertRegex(done.stdout, r"good\.png: fine: .*40 x 30, RGB, 8 bit")

    def test_every_truncation_is_refused(self):
        whole = png(self.folder / "good.png", 24, 24)
        cut = self.folder / "cut.png"
        for size in (0, 1, 8, 20, 33, len(whole) // 2, len(whole) - 13):
            with self.subTest(size=size):
                cut.write_bytes(whole[:size])
                done = self.check(cut)
                self.assertEqual(done.returncode, 65, done.stdout)
                self.assertRegex(done.stdout, r"cut\.png: refused \(\w+\): .+\n$")
                self.assertEqual(done.stdout.count("\n"), 1)

    def test_a_flipped_byte_is_refused(self):
        whole = bytearray(png(self.folder / "good.png", 24, 24))
        whole[len(whole) // 2] ^= 0xff
        (self.folder / "bad.png").write_bytes(whole)
        self.assertEqual(self.check(self.folder / "bad.png").returncode, 65)

    def test_a_bad_file_does_not_hide_behind_a_good_one(self):
        png(self.folder / "good.png", 24, 24)
        (self.folder / "text.png").write_text("not a picture")
        done = self.check(self.folder / "text.png", self.folder / "good.png")
        self.assertEqual(done.returncode, 65)
        self.assertEqual(len(done.stdout.splitlines()), 2)
        done = self.check(self.folder / "nowhere.png", self.folder / "good.png")
        self.assertEqual(done.returncode, 66)
        self.assertIn("good.png: fine", done.stdout)


class Import(Bench):
    """What import refuses, and that it says so in one line."""

    def refuse(self, code, job=None, folder="scans"):
        place = self.folder / folder
        place.mkdir(exist_ok=True)
        if job is not None:
            (place / "job.json").write_text(job, encoding="utf-8")
        return self.refused(self.call("import", str(place)), code)

    def test_a_folder_without_job_json_is_66_and_names_it(self):
        self.assertIn("job.json", self.refuse(66))
        self.refused(self.call("import", str(self.folder / "nowhere")), 66)

    def test_a_wrong_job_is_65(self):
        for job in ("", "{", "[]", "{}", '{"specimen": 7}', '{"specimen": ""}',
                    '{"specimen": "a", "px_um": -1}', '{"specimen": "a", "region": "../x.mhd"}',
                    '{"specimen": "a", "layout": [0, 4]}', '{"specimen": "a", "kind": "soup"}'):
            with self.subTest(job=job):
                self.refuse(65, job)
        self.assertEqual(self.json("status")["queue"]["waiting"], 0)

    def test_importing_again_takes_nothing_twice(self):
        place = self.job("one", panels=2)
        self.assertEqual(self.json("import", place)["panels_taken"], 2)
        again = self.json("import", place)
        self.assertEqual((again["panels_taken"], again["panels_again"]), (0, 2))
        self.assertEqual(self.json("status")["queue"]["waiting"], 3)

    def test_another_job_of_the_same_name_needs_replace(self):
        self.imported("one")
        place = self.job("one", week=3)
        self.refused(self.call("import", place), 65)
        self.assertEqual(self.call("import", "--replace", place).returncode, 0)


class Run(Bench):
    """The queue to its end."""

    def test_an_empty_queue_is_no_error_and_nothing_to_say(self):
        self.empty_store()
        done = self.call("run")
        self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))
        self.assertEqual(self.json("run"), {"done": 0, "failed": 0, "waiting": 0, "specimens": 0,
                                            "withheld": 0})

    def test_a_truncated_panel_costs_only_itself(self):
        place = self.job("one", panels=2)
        file = pathlib.Path(place) / "scan_P02.png"
        file.write_bytes(file.read_bytes()[:-40])
        self.assertEqual(self.call("import", place).returncode, 0)
        self.reported_tile()
        rows = {r["specimen"]: r for r in self.json("status")["specimens"]}
        self.assertEqual(rows["tile"]["state"], "reported")
        self.assertEqual(rows["one"]["state"], "withheld")
        panels = self.json("show", "one")["panels"]
        self.assertEqual([p["state"] for p in panels], ["refused", "refused"])
        self.assertRegex(panels[1]["message"], "truncated|ends")
        self.assertEqual(self.json("status")["queue"]["waiting"], 0)

    def test_a_figure_that_does_not_exist_is_null(self):
        self.reported_tile()
        row = self.json("status")["specimens"][0]
        self.assertIsNone(row["loss_percent"])
        self.assertIsInstance(row["mean_density"], float)

    def test_threads_out_of_range_are_refused(self):
        self.imported("one")
        for threads in ("x", "-1", "65", "1.5"):
            self.assertNotEqual(self.call("run", "--threads", threads).returncode, 0)
        self.assertEqual(self.json("status")["queue"]["waiting"], 2)


class Told(Bench):
    """What a person says to the bench."""

    def setUp(self):
        super().setUp()
        self.imported("R07-left", panels=2)
        self.scene = Scene(self.store / "gieson.db")
        self.addCleanup(self.scene.close)
        self.scene.source("copystand", "ptp:any", "ready")

    def test_what_came_before_the_service_died_is_told_and_filed_by_run(self):
        self.scene.arrival("copystand", "R07-left-P07.jpg")
        self.assertEqual(self.json("status")["unsettled"], 1)
        self.assertIn("1 picture came in, is safe and not filed yet: `gieson run` does it",
                      " ".join(self.call("status").stdout.split()))
        self.call("run")
        self.assertEqual(self.json("status")["unsettled"], 0)
        self.assertNotIn("came in, is safe", self.call("status").stdout)
        self.assertIn(7, [p["number"] for p in self.json("show", "R07-left")["panels"]])

    def test_an_unfiled_scan_is_told_and_filed_and_then_no_longer_told(self):
        scan = self.scene.scan("copystand", "IMG_0041.JPG", reason="nobody knows whose it is",
                               age=100)
        told = self.json("status")["unfiled"]
        self.assertEqual([(s["scan"], s["source"], s["name"], s["reason"]) for s in told],
                         [(scan, "copystand", "IMG_0041.JPG", "nobody knows whose it is")])
        self.assertEqual(told[0]["action"], f"gieson file {scan} SPECIMEN --panel N")
        self.assertIn(f"    next: {told[0]['action']}\n", self.call("status").stdout)
        done = self.json("file", str(scan), "R07-left", "--panel", "7")
        self.assertEqual(done, {"scan": scan, "specimen": "R07-left", "panel": 7})
        self.assertEqual(self.json("status")["unfiled"], [])
        panels = self.json("show", "R07-left")["panels"]
        self.assertEqual([p["number"] for p in panels], [1, 2, 7])
        self.assertEqual(panels[2]["file"], "IMG_0041.JPG")
        again = self.call("file", str(scan), "R07-right", "--panel", "1")
        self.assertIn(f"`gieson file {scan} undo` takes that back", again.stderr)
        self.assertEqual(self.json("file", str(scan), "undo"),
                         {"scan": scan, "specimen": None, "panel": None})
        self.assertEqual([s["scan"] for s in self.json("status")["unfiled"]], [scan])
        self.assertNotIn(7, [p["number"] for p in self.json("show", "R07-left")["panels"]])
        self.assertEqual(self.call("file", str(scan), "undo").returncode, 65)

    def test_a_held_panel_that_came_by_a_source_is_given_its_number(self):
        self.scene.panel(1, 0, "held", "no number in its name", age=100, name="IMG_0042.JPG")
        panel = self.json("show", "R07-left")["panels"][-1]
        scan = self.scene.db.execute("SELECT max(id) FROM scan").fetchone()[0]
        self.assertEqual((panel["state"], panel["action"]),
                         ("held", f"gieson file {scan} R07-left --panel N"))
        self.assertIn(f"    next: {panel['action']}\n", self.call("show", "R07-left").stdout)
        self.assertEqual(self.call(*panel["action"].replace("N", "5").split()[1:]).returncode, 0)
        self.assertIn(5, [p["number"] for p in self.json("show", "R07-left")["panels"]])

    def section(self, panel, slot, state, flags):
        self.scene.run("INSERT INTO section (id, panel_id, slot, serial, state, flags, bbox_x, "
                       "bbox_y, bbox_w, bbox_h, area_px) VALUES (?, ?, ?, ?, ?, ?, 10, 20, 30, 40, "
                       "900)", panel * 4096 + slot, panel, slot,
                       0 if "scrap" in flags else slot, state, flags)

    def test_what_is_held_is_asked_and_the_answer_is_taken_once(self):
        panel = self.scene.panel(1, 9)
        for slot, state, flags in ((1, "held", "touching"), (2, "held", "touching"),
                                   (3, "missing", ""), (4, "found", ""), (13, "held", "scrap")):
            self.section(panel, slot, state, flags)
        shown = self.call("show", "R07-left").stdout
        self.assertIn("    next: gieson decide R07-left 9.1 cut, or hold\n", shown)
        self.assertIn("    next: gieson decide R07-left 9.13 slot N, or dismiss\n", shown)
        done = self.json("decide", "R07-left", "9.1", "cut", "--because", "clear under the lens")
        self.assertEqual(done, {"specimen": "R07-left", "panel": 9, "slot": 1, "answer": "cut",
                                "again": False})
        events = "SELECT count(*) FROM event WHERE kind = 'decide'"
        self.assertEqual(self.scene.db.execute(events).fetchone()[0], 1)
        self.assertTrue(self.json("decide", "R07-left", "9.1", "cut")["again"])
        self.assertEqual(self.scene.db.execute(events).fetchone()[0], 1)
        self.assertNotIn("9.1 cut", self.call("show", "R07-left").stdout)
        self.assertIn("already", self.refused(self.call("decide", "R07-left", "9.13", "slot", "4"),
                                              65))
        self.assertEqual(self.call("decide", "R07-left", "9.13", "slot", "3").returncode, 0)
        self.assertIn("9.1 of R07-left: undo",
                      self.call("decide", "R07-left", "9.1", "undo").stdout)
        self.assertEqual(self.scene.db.execute(events).fetchone()[0], 3)

    def test_an_answer_that_nobody_asked_for_is_refused_and_changes_nothing(self):
        panel = self.scene.panel(1, 9)
        self.section(panel, 1, "found", "")
        for place, answer, status in (("9.1", ["cut"], 65), ("9.1", ["dismiss"], 65),
                                      ("9.1", ["slot", "2"], 65), ("9.7", ["cut"], 66),
                                      ("9", ["lost"], 65), ("9", ["use", "P09.tif"], 65),
                                      ("8", ["first", "1"], 66), ("9", ["first", "99"], 65)):
            with self.subTest(place=place, answer=answer):
                self.refused(self.call("decide", "R07-left", place, *answer), status)
        self.refused(self.call("decide", "nobody", "1.1", "cut"), 66)
        self.assertEqual(self.scene.db.execute("SELECT count(*) FROM decision").fetchone()[0], 0)

    def candidates(self, panel, slot, chosen=0):
        """Two poses on marks 1 and 2: as it is, and the other way round."""
        marks = ([1, 100.25, 50, 7, 1, 0, 1, .9], [1, 30.5, 80.75, 7, 1, 0, 1, .9], [0] * 8)
        poses = [{"chosen": int(chosen == k + 1), "mirrored": k, "flipped": k, "rotated180": 1 - k,
                  "share": (.9996, .0004)[k], "error_um": (17.25, None)[k],
                  "differs": ("on two marks, without mark 3", "the same spots, the other way up")[k],
                  "mark": sum((marks[m] for m in ((0, 1, 2), (1, 0, 2))[k]), [])} for k in (0, 1)]
        self.scene.run("UPDATE section SET candidates = ? WHERE panel_id = ? AND slot = ?",
                       json.dumps(poses), panel, slot)

    def test_the_poses_of_a_doubtful_section_are_listed_and_one_is_chosen(self):
        panel = self.scene.panel(1, 9)
        self.section(panel, 6, "needs-eye", "two-marks")
        self.candidates(panel, 6)
        shown = self.call("show", "R07-left").stdout
        self.assertIn("    pose    likely      error  side  turned\n"
                      "       1   100.0 %    17.2 um  up    yes     on two marks, without mark 3\n"
                      "       2   < 0.1 %          -  down  no      the same spots, the other way "
                      "up\n    next: gieson decide R07-left 9.6 pose N\n", shown)
        self.assertIn("section 9.6  needs-eye  two-marks\n", shown)
        self.scene.run("UPDATE section SET state = 'found', flags = '' WHERE slot = 6")
        self.assertIn("section 9.6  found, but its marks are in doubt",
                      self.call("show", "R07-left").stdout)
        self.scene.run("UPDATE section SET state = 'needs-eye', flags = 'two-marks' WHERE slot = 6")
        listed = self.json("show", "R07-left")["sections"][-1]
        self.assertEqual(listed["action"], "gieson decide R07-left 9.6 pose N")
        self.assertEqual([c["number"] for c in listed["candidates"]], [1, 2])
        self.assertIsNone(listed["candidates"][1]["error_um"])
        top = self.call("top").stdout
        self.assertIn("needs-eye", top)
        self.assertIn("    next: gieson decide R07-left 9.6 pose N\n", top)

        done = self.json("decide", "R07-left", "9.6", "pose", "2", "--because", "the hole is left")
        self.assertEqual((done["answer"], done["again"]), ("pose", False))
        self.assertTrue(self.json("decide", "R07-left", "9.6", "pose", "2")["again"])
        digest = self.scene.db.execute("SELECT sha256 FROM panel WHERE id = ?",
                                       (panel,)).fetchone()[0]
        self.assertEqual(self.scene.db.execute("SELECT answer FROM decision").fetchall(),
                         [(f"pose 2 of {digest} down 30.5,80.8 100.2,50.0 -",)])
        shown = self.call("show", "R07-left").stdout
        self.assertIn("    pose 2, as ", shown)
        self.assertNotIn("9.6 pose", shown)
        self.assertNotIn("needs-eye", self.call("top").stdout)

    def test_a_choice_that_was_used_or_could_not_be_is_said(self):
        panel = self.scene.panel(1, 9)
        self.section(panel, 6, "found", "two-marks decided")
        self.candidates(panel, 6, chosen=2)
        self.assertEqual(self.call("decide", "R07-left", "9.6", "pose", "2", "--because",
                                   "the hole").returncode, 0)
        shown = self.call("show", "R07-left").stdout
        self.assertIn("    *  2", shown)
        self.assertRegex(shown, r"(?m)^    chosen by .*: the hole$")
        self.assertNotIn("9.6 pose", shown)
        self.scene.run("UPDATE section SET flags = 'two-marks decision-void', state = 'needs-eye' "
                       "WHERE slot = 6")
        self.candidates(panel, 6)
        shown = self.call("show", "R07-left").stdout
        self.assertRegex(shown, r"(?m)^    what .* chose is not found there any more and is not used$")
        self.assertIn("    next: gieson decide R07-left 9.6 pose N\n", shown)

    def test_a_pose_that_is_not_listed_is_refused_and_changes_nothing(self):
        panel = self.scene.panel(1, 9)
        self.section(panel, 1, "found", "")
        self.section(panel, 6, "needs-eye", "two-marks")
        self.candidates(panel, 6)
        for place, number, status, says in (
                ("9.6", "3", 65, "has 2 poses to choose from, so none is 3"),
                ("9.1", "1", 65, "slot 1 of panel 9 has no poses to choose from"),
                ("9.7", "1", 66, "has no slot 7 that was looked at"),
                ("9", "1", 64, "is said of a slot"), ("9.6", "x", 64, "a pose is named by its"),
                ("9.6", "0", 64, "a pose is named by its number")):
            with self.subTest(place=place, number=number):
                self.assertIn(says, self.refused(self.call("decide", "R07-left", place, "pose",
                                                           number), status))
        self.assertEqual(self.scene.db.execute("SELECT count(*) FROM decision").fetchone()[0], 0)

    def test_one_of_two_scans_is_chosen_by_its_name_or_its_hash(self):
        for name in ("a.tif", "b.tif"):
            self.scene.panel(1, 9, "held", "panel number 9 is claimed twice", name=name)
        self.scene.run("UPDATE panel SET width = 100 WHERE number = 9")
        shown = self.call("show", "R07-left").stdout
        self.assertIn("    next: gieson decide R07-left 9 use a.tif\n", shown)
        self.assertIn("    next: gieson decide R07-left 9 use b.tif\n", shown)
        self.assertEqual(self.call("decide", "R07-left", "9", "use", "b.tif").returncode, 0)
        digest = self.scene.db.execute("SELECT sha256 FROM panel WHERE file_name = 'a.tif' AND "
                                       "number = 9").fetchone()[0]
        self.refused(self.call("decide", "R07-left", "9", "use", "c.tif"), 66)
        self.assertEqual(self.call("decide", "R07-left", "9", "use", digest).returncode, 0)
        self.assertEqual(self.scene.db.execute("SELECT answer FROM decision").fetchall(),
                         [("use " + digest,)])

    def test_a_specimen_names_the_sources_that_deliver_it_and_their_troubles(self):
        self.assertEqual(self.call("expect", "copystand", "R07-left").returncode, 0)
        self.scene.trouble("copystand", "bad.jpg", "bad.jpg ends too early", "scan it again")
        self.assertEqual(self.json("show", "R07-left")["delivered_by"], ["copystand"])
        shown = self.call("show", "R07-left").stdout
        self.assertIn("  delivered by copystand, which is ready\n", shown)
        self.assertIn("  trouble  bad.jpg\n    bad.jpg ends too early\n    next: scan it again\n",
                      shown)

    def test_what_cannot_be_filed_is_refused_and_changes_nothing(self):
        scan = str(self.scene.scan("copystand", "IMG_0041.JPG", reason="nobody knows"))
        self.refused(self.call("file", scan, "nobody", "--panel", "1"), 66)
        self.refused(self.call("file", "99", "R07-left", "--panel", "1"), 66)
        self.assertEqual(self.call("file", scan, "R07-left", "--panel=3").returncode, 0)
        self.refused(self.call("file", scan, "R07-left", "--panel", "4"), 65)
        self.assertEqual(len(self.json("show", "R07-left")["panels"]), 3)

    def test_a_source_delivers_a_specimen_until_somebody_says_otherwise(self):
        self.assertEqual(self.json("expect", "copystand", "R07-left"),
                         {"source": "copystand", "delivers": "R07-left"})
        self.assertEqual(self.json("status")["sources"][0]["delivers"], "R07-left")
        self.assertIn("delivers R07-left", self.call("status").stdout)
        self.assertEqual(self.json("expect", "copystand", "--nobody")["delivers"], "")
        self.assertEqual(self.json("status")["sources"][0]["delivers"], "")
        self.refused(self.call("expect", "copystand", "nobody"), 66)
        self.assertIn("gieson status",
                      self.refused(self.call("expect", "nowhere", "R07-left"), 66))

    def test_a_trouble_is_told_with_what_to_do(self):
        self.scene.trouble("copystand", "bad.jpg", "bad.jpg ends too early", "scan it again", 3)
        trouble = self.json("status")["troubles"][0]
        self.assertEqual((trouble["name"], trouble["tries"]), ("bad.jpg", 3))
        self.assertIn("! trouble bad.jpg from copystand\n    bad.jpg ends too early\n"
                      "    next: scan it again\n", self.call("status").stdout)

    def test_a_capture_without_the_service_is_75_and_leaves_no_request(self):
        self.assertIn("systemctl start", self.refused(self.call("capture", "copystand"), 75))
        self.refused(self.call("capture", "nowhere", "--blank"), 66)
        self.assertEqual(self.scene.db.execute("SELECT count(*) FROM request").fetchone()[0], 0)

    def capture_answered(self, kind, state, message, *args):
        """As the service would: it holds its lock and answers."""
        def answer():
            db = sqlite3.connect(self.store / "gieson.db", isolation_level=None, timeout=30)
            end = time.monotonic() + 30
            while time.monotonic() < end and not db.execute(
                    "UPDATE request SET state = ?, message = ? WHERE state = 'waiting' AND "
                    "kind = ?", (state, message, kind)).rowcount:
                time.sleep(0.02)
            db.close()

        with open(self.store / "giesond.lock", "w", encoding="utf-8") as lock:
            bench.hold_lock(lock, 0)
            service = threading.Thread(target=answer)
            service.start()
            done = self.call("capture", "copystand", *args)
            service.join()
        return done

    def test_a_capture_waits_for_its_answer(self):
        done = self.capture_answered("capture-panel", "done", "")
        self.assertEqual((done.returncode, done.stdout), (0, "copystand took its picture\n"))
        done = self.capture_answered("capture-dark", "done", "", "--dark", "--json")
        self.assertEqual(json.loads(done.stdout)["kind"], "capture-dark")
        done = self.capture_answered("capture-blank", "refused", "the lens is covered", "--blank")
        self.assertIn("the lens is covered", self.refused(done, 65))


class Config(Bench):
    """The service's configuration, before it is used."""

    def check(self, text):
        file = self.folder / "gieson.conf"
        file.write_text(text, encoding="utf-8")
        return file, self.call("check-config", str(file), store=False)

    def test_a_good_one_is_fine(self):
        (self.folder / "scans").mkdir()
        _, done = self.check(f"[source scanner]\nAddress=hot:{self.folder}/scans\n")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertIn("1 source", done.stdout)

    def test_mistakes_are_78_with_file_line_and_reason(self):
        file, done = self.check("[work]\nWorkers=many\n[kitchen]\nSink=1\n")
        self.assertEqual((done.returncode, done.stdout), (78, ""))
        self.assertRegex(done.stderr, rf"(?m)^{re.escape(str(file))}:2: .*Workers")
        self.assertRegex(done.stderr, rf"(?m)^{re.escape(str(file))}:[34]: .*kitchen")

    def test_json_lists_the_mistakes_and_nothing_else_is_printed(self):
        file, _ = self.check("[work]\nWorkers=many\n")
        done = self.call("check-config", str(file), "--json", store=False)
        self.assertEqual((done.returncode, done.stderr), (78, ""))
        told = json.loads(done.stdout)
        self.assertEqual((told["fine"], told["sources"], len(told["mistakes"])), (False, None, 1))
        self.assertIn("Workers", told["mistakes"][0])
        file, _ = self.check("[work]\nWorkers=2\n")
        done = self.call("check-config", str(file), "--json", store=False)
        self.assertEqual((done.returncode, json.loads(done.stdout)["workers"]), (0, 2))


# A PTP camera whose node may not be spoken to, and a UVC camera with an odd name.
DEVICES = """P: /devices/pci0000:00/usb1/1-1
N: bus/usb/001/007
E: SUBSYSTEM=usb
E: DEVTYPE=usb_device
E: BUSNUM=001
E: DEVNUM=007
E: DEVNAME=/dev/bus/usb/001/007
A: busnum=1\\n
A: devnum=7\\n
A: speed=480\\n
A: bConfigurationValue=1\\n
H: descriptors={}

P: /devices/pci0000:00/video4linux/video3
N: video3
S: v4l/by-id/usb-Cheap_Cam_7-video-index0
E: SUBSYSTEM=video4linux
E: DEVNAME=/dev/video3
A: name=Cheap \033[31m Cam\\n

"""
DESCRIPTORS = ("12010002000000 40 a904 1932 0001 000000 01"  # 04a9:3219, no strings
               "09022700010100c032" "090400000306010100"    # one interface, 06/01/01
               "07058102000200" "07050202000200" "07058303080009").replace(" ", "")


class Devices(Bench):
    """What is plugged in."""

    def devices(self, *args):
        if not shutil.which("umockdev-run"):
            self.skipTest("umockdev is not there")
        if b"__asan_init" in (bench.BIN / "gieson-intake").read_bytes():
            self.skipTest("ASan must come first, and umockdev must too")
        file = self.folder / "bench.umockdev"
        file.write_text(DEVICES.format(DESCRIPTORS), encoding="utf-8")
        done = bench.subprocess.run(["umockdev-run", "-d", str(file), "--",
                                     str(bench.BIN / "gieson"), "devices", *args],
                                    env=self.environment(), capture_output=True, encoding="utf-8",
                                    check=False, timeout=60)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return done.stdout

    def test_each_has_its_address_and_its_name(self):
        told = json.loads(self.devices("--json"))["devices"]
        self.assertEqual([d["address"] for d in told],
                         ["ptp:04a9:3219", "v4l2:usb-Cheap_Cam_7-video-index0"])
        self.assertEqual(told[1]["name"], "Cheap \x1b[31m Cam")

    def test_a_devices_name_is_no_command_to_the_terminal(self):
        lines = self.devices().splitlines()
        self.assertEqual(len(lines), 2)
        self.assertEqual(lines[1], "v4l2:usb-Cheap_Cam_7-video-index0  Cheap ?[31m Cam")

    def test_nothing_is_no_error(self):
        self.refused(self.call("devices", "more", store=False), 64)
        done = self.call("devices", store=False)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertGreaterEqual(done.stdout.count("\n"), 1)


class Night(Bench):
    """What changed is worked, and nothing else."""

    def worked(self, **more):
        done = self.call("--json", "night", **more)
        told = [(r["specimen"], r["state"]) for r in json.loads(done.stdout)["worked"]]
        self.assertEqual(done.returncode, 65 if any(s != "reported" for _, s in told) else 0)
        return told

    def test_new_panels_and_new_settings_are_worked_and_a_second_night_has_nothing_to_do(self):
        self.imported("one")
        self.imported("two", folder="more")
        self.assertEqual(self.worked(), [("one", "withheld"), ("two", "withheld")])
        done = self.call("night")
        self.assertEqual((done.returncode, done.stdout, done.stderr),
                         (0, "nothing changed since the last reports\n", ""))
        self.assertEqual(self.worked(), [])
        place = self.job("one", week=3)
        self.assertEqual(self.call("import", "--replace", place).returncode, 0)
        done = self.call("night")
        self.assertRegex(done.stdout, r"^one: withheld: .+\n$")
        self.assertEqual(done.returncode, 65)
        words = (self.store / "night.txt").read_text()
        self.assertRegex(words, r"^gieson, \d{4}-\d\d-\d\d \d\d:\d\d: 1 specimen computed, 0 reported, "
                         r"1 withheld\. \d+ panels? and \d+ sections? of the store need a person: "
                         r"`gieson status`\. All of it: \S+/index.html\n"
                         r"one: withheld: .+; next: `gieson .+`\n$")
        png(place + "/scan_P02.png", 32, 32, seed=5)
        self.assertEqual(self.call("import", place).returncode, 0)
        self.assertEqual(self.worked(), [("one", "withheld")])
        self.assertEqual(self.worked(), [])

    def test_a_change_that_nobody_asked_for_is_seen_from_the_rows(self):
        self.reported_tile()
        self.assertEqual(self.worked(), [])
        with sqlite3.connect(self.store / "gieson.db") as db:
            db.execute("UPDATE specimen SET job_sha256 = ?", ("7" * 64,))
        db.close()
        self.assertEqual(self.worked(), [("tile", "reported")])
        self.assertEqual(self.worked(), [])

    def test_what_failed_earlier_is_told_and_not_tried_again_without_a_change(self):
        self.imported("one")
        self.assertEqual(self.call("run").returncode, 65)  # all withheld
        with sqlite3.connect(self.store / "gieson.db") as db:
            db.execute("UPDATE job SET state = 'failed', message = 'no mesh' WHERE kind = "
                       "'specimen'")
        db.close()
        done = self.call("night")
        self.assertEqual((done.returncode, done.stdout),
                         (0, "nothing changed since the last reports\n"))
        self.assertIn("1 specimen failed earlier", done.stderr)
        self.assertEqual(self.call("retry").returncode, 0)
        self.assertEqual(self.worked(), [("one", "withheld")])

    def test_a_failure_in_the_night_is_65_and_costs_only_itself(self):
        png(self.folder / "bad.png", seed=9)
        self.assertEqual(self.call("import", "--tile", str(self.folder / "bad.png")).returncode, 0)
        self.reported_tile("good")
        with sqlite3.connect(self.store / "gieson.db") as db:
            sha = db.execute("SELECT a.sha256 FROM attachment a JOIN specimen s ON s.id = "
                             "a.specimen_id WHERE s.name = 'bad'").fetchone()[0]
            db.execute("UPDATE specimen SET job_sha256 = ?", ("7" * 64,))
        db.close()
        other = self.store / "objects" / sha[:2] / sha[2:]
        other.chmod(0o644)
        png(self.folder / "other.png", 40, 40, seed=77)
        other.write_bytes((self.folder / "other.png").read_bytes())
        told = self.json("night", code=65)
        self.assertEqual({r["specimen"]: r["state"] for r in told["worked"]}["bad"], "failed")
        self.assertEqual(told["failed"], 1)


class Slurm(Bench):
    """A night is handed over as two jobs; an sbatch of ours writes down what it was given."""

    def setUp(self):
        super().setUp()
        self.store = self.folder / "%A $HOME 'it''s'"  # patterns of Slurm's and of a shell's
        tools = self.folder / "tools"
        tools.mkdir()
        (tools / "sbatch").write_text(f'#!/bin/sh\nprintf "%s\\0" "$@" >>"{self.folder}/given"\n'
                                      f'printf "\\n\\0" >>"{self.folder}/given"\necho "${{ANSWER-41;bench}}"\n')
        (tools / "sbatch").chmod(0o755)
        self.path = {"PATH": f"{tools}:{os.environ['PATH']}"}

    def given(self):
        """What each sbatch was given."""
        return [job.split("\0")[:-1] for job in (self.folder / "given").read_text().split("\n\0")[:-1]]

    def states(self):
        return [s["state"] for s in self.json("status")["specimens"]]

    def test_sbatch_is_given_words_and_its_two_jobs_do_the_night(self):
        self.imported("one")
        self.imported("two", folder="more")
        done = self.call("night", "--slurm", "--threads", "2", env=self.path)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertRegex(" ".join(done.stdout.split()), r"^2 specimens: job 41 of Slurm \(2 tasks\) computes, job 41 makes")
        self.assertEqual(self.states(), ["waiting", "waiting"])
        share, rest = self.given()
        task, gieson = str(bench.BIN / "gieson-slurm-task"), str(bench.BIN / "gieson")
        began = share[share.index("--share") + 1]
        for job, where, what in ((share, "--array=1-2", "--share"), (rest, "--dependency=afterany:41", "--rest")):
            self.assertEqual(job, ["--parsable", "--requeue", "--job-name=gieson-night", f"--chdir={self.store}",
                                   "--output=\\night.log", "--open-mode=append", "--cpus-per-task=2", where,
                                   task, gieson, "--store", str(self.store), "night", what, began,
                                   "--threads", "2"])
        # As Slurm does it: the script with its words, twice for the array.
        for job, ends in ((share, 0), (share, 0), (rest, 65)):
            done = subprocess.run(job[job.index(task):], capture_output=True, text=True)
            self.assertEqual(done.returncode, ends, done.stderr)
        self.assertEqual([line.split(":")[0] for line in done.stdout.splitlines() if not line.startswith(" ")],
                         ["one", "two"])
        self.assertEqual(self.states(), ["withheld", "withheld"])
        self.assertIn(": 2 specimens computed, 0 reported, 2 withheld.", (self.store / "night.txt").read_text())
        self.assertTrue((self.store / "index.html").exists())
        # Nothing changed: nothing is submitted.
        done = self.call("night", "--slurm", env=self.path)
        self.assertEqual((done.returncode, done.stdout), (0, "nothing changed since the last reports\n"))
        self.assertEqual(len(self.given()), 2)
        # One of the two changed: it alone is told, though it failed and has no new run.
        self.assertEqual(self.call("import", "--replace", self.job("one", week=3)).returncode, 0)
        self.assertEqual(self.call("night", "--slurm", env=self.path).returncode, 0)
        with sqlite3.connect(self.store / "gieson.db") as db:
            db.execute("UPDATE job SET state = 'failed', message = 'no mesh' WHERE state = 'waiting'")
        db.close()
        rest = self.given()[3]
        done = subprocess.run(rest[rest.index(task):], capture_output=True, text=True)
        self.assertRegex(done.stdout, r"^one: failed: no mesh\n$")

    def test_a_task_on_another_machine_does_nothing_and_says_so(self):
        self.imported("one")
        self.assertEqual(self.call("night", "--slurm", env=self.path).returncode, 0)
        self.assertIn("--exclusive", self.given()[0])
        began = json.loads(self.given()[0][-1])
        began["boot"] = "7" * 36
        for part in ("--share", "--rest"):
            self.assertIn("another machine", self.refused(self.call("night", part, json.dumps(began)), 69))
        self.assertEqual(self.states(), ["waiting"])

    def test_a_task_ends_when_others_are_at_all_that_is_left(self):
        self.imported("one")
        self.assertEqual(self.call("night", "--slurm", env=self.path).returncode, 0)
        boot = pathlib.Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        with sqlite3.connect(self.store / "gieson.db") as db:
            db.execute("UPDATE job SET state = 'running', owner = 'another', boot = ?, processes = ?, pid = ?, "
                       "lease_s = 600, lease_until = ?", (boot, os.readlink("/proc/self/ns/pid"), os.getpid(),
                                                          int(time.clock_gettime(time.CLOCK_BOOTTIME)) + 600))
        db.close()
        done = self.call("night", "--share", self.given()[0][-1], timeout=60)
        self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))
        self.assertEqual(self.states(), ["working"])

    def test_where_slurm_takes_nothing_all_waits_on(self):
        self.imported("one")
        self.assertIn("slurm-client", self.refused(self.call("night", "--slurm", env={"PATH": "/nowhere"}), 69))
        self.assertIn("no number of a job: sorry",
                      self.refused(self.call("night", "--slurm", env={**self.path, "ANSWER": "sorry"}), 69))
        self.assertIn("from / on", self.refused(
            self.call("night", "--slurm", env={**self.path, "GIESON_PUBLISH": "web"}), 65))
        self.assertEqual(self.states(), ["waiting"])


class Scrub(Bench):
    """Originals are read again."""

    def objects(self):
        return sorted(p for p in (self.store / "objects").glob("??/*") if p.is_file())

    def damage(self, path):
        path.chmod(0o644)
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)

    def diary(self, kind):
        with sqlite3.connect(self.store / "gieson.db") as db:
            rows = db.execute("SELECT subject, text FROM event WHERE kind = ?", (kind,)).fetchall()
        db.close()
        return rows

    def test_a_whole_store_is_whole(self):
        self.imported("one", panels=3)
        told = self.json("scrub")
        size = sum(p.stat().st_size for p in self.objects())
        self.assertEqual((told["checked"], told["bytes"], told["damaged"], told["complete"]),
                         (3, size, [], True))
        self.assertEqual(self.diary("scrub"), [("", "3 objects read again, 0 damaged")])
        self.assertFalse((self.store / "scrub.json").exists())

    def test_a_damaged_and_a_lost_object_are_named_with_their_panels_until_they_are_mended(self):
        place = self.job("one", panels=3)
        self.assertEqual(self.call("import", place).returncode, 0)
        broken, lost, _ = self.objects()
        self.damage(broken)
        lost.unlink()
        done = self.call("scrub")
        self.assertEqual(done.returncode, 65)
        self.assertRegex(done.stdout, r"(?m)^3 objects \(.* MB\) read again, 2 damaged$")
        self.assertEqual(done.stderr.count("\n"), 2)
        self.assertRegex(done.stderr, r"scan_P0\d\.png of one rests on it: .*its bytes are no "
                         r"longer those that came in; import the original again")
        self.assertEqual({s for s, _ in self.diary("damaged")},
                         {p.parent.name + p.name for p in (broken, lost)})
        self.assertEqual(len(self.json("status")["troubles"]), 2)
        self.assertIn("next: import the original again", self.call("status").stdout)
        self.assertEqual(self.call("import", place).returncode, 0)
        self.assertEqual(self.json("scrub")["damaged"], [])
        self.assertEqual(self.json("status")["troubles"], [])

    def test_a_round_goes_on_where_the_last_one_stopped(self):
        self.imported("one", panels=4)
        names = [p.parent.name + p.name for p in self.objects()]
        (self.store / "scrub.json").write_text(
            json.dumps({"after": names[1], "checked": 2, "damaged": 0}), encoding="utf-8")
        told = self.json("scrub", "--minutes", "5")
        self.assertEqual((told["checked"], told["round_checked"], told["complete"]), (2, 4, True))
        self.assertEqual(self.diary("scrub"), [("", "4 objects read again, 0 damaged")])
        (self.store / "scrub.json").write_text("{junk", encoding="utf-8")
        self.assertEqual(self.json("scrub")["checked"], 4)


class Backup(Bench):
    """A second copy, and a store from it."""

    def test_a_restored_backup_is_the_same_store_and_verifies(self):
        self.reported_tile()
        self.imported("one", panels=3)
        before = self.call("report", "tile", "--json").stdout
        there = self.folder / "usb" / "2026-11"
        told = self.json("backup", str(there))
        self.assertEqual(told["objects"], 4)
        again = self.folder / "again"
        done = self.call("--store", str(again), "restore", str(there), store=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("all read back and the same", done.stdout)
        for store in (there, again):
            done = self.call("--store", str(store), "verify", "tile", store=False)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            self.assertEqual(self.call("--store", str(store), "report", "tile", "--json",
                                       store=False).stdout, before)
            self.assertEqual(self.call("--store", str(store), "scrub", store=False).returncode, 0)
        self.assertEqual(self.json("scrub")["findings"], [])
        # What leads to the reports is there at once, not from the next run on.
        self.assertTrue((again / "reports" / "tile" / "latest" / "report.html").is_file())
        self.assertEqual(os.readlink(again / "reports" / "tile" / "latest"),
                         os.readlink(self.store / "reports" / "tile" / "latest"))
        self.assertIn("reports/tile/", (again / "index.html").read_text())

    def test_nothing_is_written_over(self):
        self.reported_tile()
        there = self.folder / "there"
        there.mkdir()
        (there / "letter").write_text("dear", encoding="utf-8")
        self.assertIn(f"{there} is not empty (letter): nothing is ever written over",
                      self.refused(self.call("backup", str(there)), 65))
        self.assertEqual(os.listdir(there), ["letter"])
        self.assertIn("is not empty", self.refused(self.call("restore", str(self.store)), 65))
        self.refused(self.call("restore", str(there)), 66)

    def test_a_damaged_store_is_not_copied_and_what_is_damaged_is_named(self):
        self.reported_tile()
        html = pathlib.Path(self.call("report", "tile").stdout.splitlines()[1])
        html.write_bytes(html.read_bytes() + b" ")
        there = self.folder / "there"
        done = self.call("backup", str(there))
        self.assertEqual(done.returncode, 65)
        self.assertRegex(done.stderr, r"damaged: .*report\.html: .*not those that the run wrote")
        self.assertIn("no backup was made", done.stderr)
        self.assertFalse((there / "gieson.db").exists())


class Disk(Bench):
    """A store that cannot be written to, seen by somebody who is not root."""

    def setUp(self):
        super().setUp()
        self.person = {}
        if os.geteuid() == 0:
            self.person = {"user": 65534, "group": 65534, "extra_groups": []}
            os.chmod(self.folder, 0o755)
            try:
                done = self.call("--version", store=False, **self.person)
            except PermissionError:
                self.skipTest("nobody may not start the programs here")
            self.assertEqual(done.returncode, 0)

    def freeze(self, *except_for):
        for path in [self.store, *self.store.rglob("*")]:
            if path not in except_for:
                os.chmod(path, 0o555 if path.is_dir() else 0o444)
        self.addCleanup(self.thaw)

    def thaw(self):
        for path in [self.store, *self.store.rglob("*")]:
            os.chmod(path, 0o755 if path.is_dir() else 0o644)

    def test_reading_works_and_writing_is_74(self):
        self.imported("one")
        scans = self.job("two", folder="more")
        self.freeze()
        done = self.call("status", **self.person)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("one", done.stdout)
        for args in (["import", scans], ["retry"]):
            with self.subTest(args=args):
                self.refused(self.call(*args, **self.person), 74)

    def test_a_run_that_cannot_write_ends_and_says_so(self):
        self.imported("one")
        self.freeze()
        done = self.call("run", **self.person)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("Permission denied", done.stderr)

    def test_a_folder_where_no_store_can_be_made_is_74(self):
        scans = self.job("one")
        os.chmod(self.folder, 0o555)
        self.addCleanup(os.chmod, self.folder, 0o755)
        self.refused(self.call("import", scans, **self.person), 74)
        self.assertFalse(self.store.exists())


class Streams(Bench):
    """Streams that are closed or full."""

    def test_an_answer_that_cannot_be_written_is_74(self):
        self.imported("one")
        for args in (["status"], ["status", "--json"], ["show", "one"]):
            with self.subTest(args=args), open("/dev/full", "w", encoding="utf-8") as full:
                done = self.call(*args, stdout=full)
                self.assertEqual(done.returncode, 74)
                self.assertEqual(done.stderr.count("\n"), 1)

    def test_a_closed_stdout_is_74_and_not_a_crash(self):
        self.imported("one")
        done = self.call("status", stdout=None, preexec_fn=lambda: os.close(1))
        self.assertEqual(done.returncode, 74)
        self.assertIn("could not be written", done.stderr)

    def test_complaints_do_not_land_in_files_when_stderr_is_closed(self):
        def close_both():
            os.close(1)
            os.close(2)

        place = self.job("one", panels=2)
        png(place + "/unnumbered.png", 32, 32, seed=8)  # import has something to say about it
        self.call("import", place, stdout=None, stderr=None, preexec_fn=close_both)
        objects = [p for p in (self.store / "objects").rglob("*") if p.is_file()]
        self.assertGreaterEqual(len(objects), 3)
        for path in objects:
            self.assertEqual(hashlib.sha256(path.read_bytes()).hexdigest(),
                             path.parent.name + path.name)

    def test_closed_streams_do_not_stop_the_mesher(self):
        def close_all():
            for fd in (0, 1, 2):
                os.close(fd)

        bench.ball(self.folder / "ball.mhd")
        done = self.call("import", "--volume", str(self.folder / "ball.mhd"), "--threshold", "50",
                         "--spacing-unit", "um")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.call("run", stdin=None, stdout=None, stderr=None, preexec_fn=close_all)
        row = self.json("status")["specimens"][0]
        self.assertEqual(row["state"], "reported", row["detail"])

    def test_a_reader_that_leaves_is_no_hang(self):
        self.imported("one")
        ours, theirs = os.pipe()
        os.close(ours)
        done = self.call("status", stdout=theirs, timeout=60)
        os.close(theirs)
        self.assertIn(done.returncode, (-13, 74))


class Terminal(Bench):
    """Narrow and wide terminals: nothing is cut off badly."""

    def lines(self, width, *args):
        code, screen = self.terminal(width, *args, env={"NO_COLOR": "1"})
        self.assertEqual(code, 0, screen)
        return screen.splitlines()

    def fits(self, width, lines):
        """A command to copy is never cut or wrapped, everything else fits."""
        for line in lines:
            if "next: gieson " not in line:
                self.assertLessEqual(columns(line), width, line)

    def test_status_fits_every_width_and_always_says_name_state_and_next(self):
        for i, name in enumerate(["GVP-D-S00", "\u6d4b\u8bd5" * 12, "n" * 70]):
            self.imported(name, folder=f"scans{i}")
        for width in (20, 30, 40, 58, 59, 60, 80, 81, 120, 200):
            with self.subTest(width=width):
                lines = self.lines(width, "status")
                if width >= 40:
                    self.fits(width, [li for li in lines if "nnnn" not in li and "\u6d4b" not in li
                                      or width > 58])
                text = "\n".join(lines)
                self.assertIn("GVP-D-S00", text)
                self.assertEqual(text.count("waiting"), 4)
                self.assertEqual(text.count("gieson run"), 3)

    def test_columns_stand_below_their_headings_whatever_the_script(self):
        for i, name in enumerate(["plain", "\u6d4b\u8bd5", "e\u0301t\u00e9"]):
            self.imported(name, folder=f"scans{i}", group="G")
        lines = self.lines(100, "status")
        where = {columns(li[:li.index("waiting")]) for li in lines if " waiting " in li[10:]}
        self.assertEqual(where, {columns(lines[1][:lines[1].index("STATE")])})

    def test_an_empty_store_and_a_panels_sentence_are_wrapped(self):
        self.empty_store()
        self.fits(40, self.lines(40, "status"))
        self.imported("one")
        self.assertEqual(self.call("run").returncode, 65)  # all withheld
        for width in (40, 80):
            self.fits(width, self.lines(width, "status"))
            self.fits(width, self.lines(width, "show", "one"))

    def test_progress_stays_on_one_line_and_ends_wiped(self):
        for width in (24, 40, 80):
            name = f"a specimen with a long name for {width} columns"
            place = self.job(name, folder=f"scans{width}")
            png(place + "/a_long_name_too_P02.png", 3600, 4800, seed=width)
            self.assertEqual(self.call("import", place).returncode, 0)
            code, screen = self.terminal(width, "run", env={"NO_COLOR": "1"})
            self.assertEqual(code, 65, screen)  # withheld
            drawn = [p for p in re.split(r"[\r\n]", screen) if p.startswith("[")]
            self.assertGreater(len(drawn), 0, "the work was too quick to be seen")
            for piece in drawn:
                self.assertLess(columns(piece), width)
                self.assertRegex(piece, r"^\[\d+/\d+\] .*(starting|\w+ \d+/\d+|~)")
            self.assertIn("\r\x1b[K", screen)
            self.assertNotIn("[", screen[screen.rindex("\x1b[K") + 3:])


def main():
    bench.BIN = pathlib.Path(sys.argv[1]).resolve()
    topic = [".".join(sys.argv[2:])] if len(sys.argv) > 2 else []
    result = unittest.main(argv=[sys.argv[0], *topic], exit=False).result
    for test, reason in result.skipped:
        print(f"skipped: {test.id()}: {reason}", file=sys.stderr)
    if not result.wasSuccessful():
        sys.exit(1)
    sys.exit(bench.SKIPPED if result.skipped and len(result.skipped) == result.testsRun else 0)


if __name__ == "__main__":
    main()
