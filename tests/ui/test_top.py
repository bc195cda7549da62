#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""gieson top as a person sees it: what stands on the terminal, key by key, while the store changes.

    test_top.py BIN [TOPIC [test]]     BIN is the folder with the programs
    test_top.py BIN --write            writes the screens anew: look at every one before it is kept
"""
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import bench  # noqa: E402
import scene  # noqa: E402
from bench import Bench, columns  # noqa: E402
from scene import Scene, Tmux  # noqa: E402

SCREENS = pathlib.Path(__file__).resolve().parent / "screens"
WRITE = False
READY = "q quit"
COLOUR = re.compile(r"\x1b\[[0-9;]*(3[0-7]|38)[;m]")
ODD_NAMES = ["x" * 1000, "Gelenk \u00dc \u6d4b\u8bd5", "e\u0301" * 30, "two\nlines",
             "red \x1b[31m\x1b]0;title\x07\x1b[2J", "tab\tand\x7fdelete", "a%sb%n", "-",
             "\u202eturned"]


class Top(Bench):
    """A store with a busy bench, and gieson top on it in a terminal of its own."""

    def setUp(self):
        super().setUp()
        if not scene.has_tmux():
            self.skipTest("tmux is not there")
        self.empty_store()
        self.scene = Scene(self.store / "gieson.db")
        self.addCleanup(self.scene.close)

    def open(self, columns=80, rows=24, before="", utf8=True, env=None):
        """The store is named without its folder, so that screens do not depend on that."""
        terminal = Tmux(columns, rows, f"env {before} {bench.BIN}/gieson --store store top",
                        self.environment(**(env or {})), self.folder, utf8)
        self.addCleanup(terminal.close)
        return terminal

    def busy(self, *args, **more):
        self.scene.busy_bench()
        terminal = self.open(*args, **more)
        terminal.wait_for_text(READY)
        return terminal

    def compare(self, name, screen):
        path = SCREENS / f"{name}.txt"
        if WRITE:
            SCREENS.mkdir(exist_ok=True)
            path.write_text(screen, encoding="utf-8")
        self.assertEqual(screen, path.read_text(encoding="utf-8"),
                         f"the screen is not that of {path.name}")


class Screens(Top):
    """What stands there, against texts that were looked at."""

    def test_the_queue_at_80x24(self):
        self.compare("queue_80x24", self.busy(80, 24).screen())

    def test_the_queue_at_100x34(self):
        self.compare("queue_100x34", self.busy(100, 34).screen())

    def test_the_queue_at_40x10(self):
        self.compare("queue_40x10", self.busy(40, 10).screen())

    def test_below_that_it_says_so_politely(self):
        self.scene.busy_bench()
        for width, height in ((39, 10), (40, 9), (20, 4)):
            with self.subTest(width=width, height=height):
                terminal = self.open(width, height)
                self.compare(f"small_{width}x{height}", terminal.wait_for_text("needs"))
                terminal.press("q")
                self.assertEqual(terminal.wait_for_end(), 0)

    def test_an_empty_store_says_what_to_do(self):
        self.compare("empty_80x24", self.open().wait_for_text(READY))

    def test_the_help(self):
        terminal = self.busy()
        terminal.press("?")
        self.compare("help_80x24", terminal.wait_for_text("any key: back"))

    def test_all_about_a_failed_specimen(self):
        terminal = self.busy()
        terminal.press(*["Down"] * 5, "Enter")
        self.compare("failed_80x24", terminal.wait_for_text("any key: back"))

    def test_all_about_an_unfiled_scan(self):
        terminal = self.busy()
        terminal.press(*["Down"] * 4, "Enter")
        self.compare("unfiled_80x24", terminal.wait_for_text("any key: back"))


class Keys(Top):
    """Every key that the help names."""

    def chosen(self, terminal):
        """The line in reverse video."""
        lines = [line for line in terminal.screen(escapes=True).split("\n")
                 if re.match(r"\x1b\[([0-9;]*;)?7m", line)]
        self.assertEqual(len(lines), 1, lines)
        return re.sub(r"\x1b\[[0-9;]*m", "", lines[0])

    def wait_chosen(self, terminal, place):
        terminal.wait_for_text(f"{place} of 14")
        return self.chosen(terminal)

    def test_arrows_and_letters_choose_line_by_line_and_skip_what_is_no_line(self):
        terminal = self.busy(80, 24)
        self.assertIn("copystand", self.wait_chosen(terminal, 1))
        for key, place, name in (("Up", 1, "copystand"), ("Down", 2, "microscope"),
                                 ("j", 3, "scanner"), ("j", 4, "P09.tif"),
                                 ("Down", 5, "IMG_0041.JPG"), ("Down", 6, "GVP-D-S03"),
                                 ("k", 5, "IMG_0041.JPG"), ("Up", 4, "P09.tif")):
            terminal.press(key)
            with self.subTest(key=key, place=place):
                self.assertIn(name, self.wait_chosen(terminal, place))

    def test_pages_and_ends(self):
        terminal = self.busy(80, 24)
        terminal.press("End")
        self.assertIn("R07-left", self.wait_chosen(terminal, 14))
        terminal.press("Home")
        self.assertIn("copystand", self.wait_chosen(terminal, 1))
        terminal.press("PageDown")
        self.assertIn("R07-left", self.wait_chosen(terminal, 14))
        terminal.press("PageUp")
        self.assertIn("copystand", self.wait_chosen(terminal, 1))

    def test_every_line_can_be_seen_on_the_smallest_screen(self):
        terminal = self.busy(40, 10)
        seen = set()
        for _ in range(14):
            seen.update(re.findall(r"copystand|microscope|scanner|P09\.tif|IMG_0041|GVP-D-S0\d|"
                                   r"panel \d|Gelenk-|R07-left", terminal.screen()))
            self.chosen(terminal)
            terminal.press("Down")
            time.sleep(0.05)
        self.assertGreaterEqual(len(seen), 13, seen)
        for _ in range(13):
            terminal.press("Up")
        terminal.wait_for_text("COMES IN")

    def test_r_lets_the_chosen_specimen_wait_again_and_says_so(self):
        terminal = self.busy()
        terminal.press(*["Down"] * 5)
        self.wait_chosen(terminal, 6)
        terminal.press("r")
        terminal.wait_for_text("1 failed job waits again; `gieson --store store run` does them")
        terminal.wait_for(lambda screen: "0 failed" in screen and "x GVP-D-S03" not in screen)
        self.assertIn("GVP-D-S03", self.chosen(terminal))

    def test_r_where_nothing_failed_changes_nothing_and_capital_r_means_all(self):
        terminal = self.busy()
        terminal.press("r")
        terminal.wait_for_text("nothing failed here")
        self.assertIn("1 failed", terminal.screen())
        terminal.press("R")
        terminal.wait_for_text("1 failed job waits again")
        terminal.wait_for_text("0 failed")

    def test_q_and_an_interrupt_and_a_signal_end_it_with_0(self):
        for end in ("q", "C-c", signal.SIGTERM):
            with self.subTest(end=end):
                terminal = self.open()
                terminal.wait_for_text(READY)
                if isinstance(end, str):
                    terminal.press(end)
                else:
                    os.kill(terminal.pid(), end)
                self.assertEqual(terminal.wait_for_end(), 0)

    def test_it_ends_with_its_terminal(self):
        terminal = self.open()
        terminal.wait_for_text(READY)
        pid = terminal.pid()
        terminal.close()
        end = time.monotonic() + scene.SECONDS
        while time.monotonic() < end and pathlib.Path(f"/proc/{pid}/exe").exists():
            time.sleep(0.05)
        self.assertFalse(pathlib.Path(f"/proc/{pid}/exe").exists())

    def test_a_page_is_left_by_any_key(self):
        terminal = self.busy()
        for into in ("?", "Enter"):
            terminal.press(into)
            terminal.wait_for_text("any key: back")
            terminal.press("Escape")
            terminal.wait_for_text("? help")


class Live(Top):
    """The store changes while it is looked at."""

    def test_a_panel_that_comes_in_appears_and_what_was_chosen_stays_chosen(self):
        terminal = self.busy(100, 34)
        terminal.press(*["Down"] * 7)
        before = terminal.wait_for_text("8 of 14")
        self.scene.source("copystand", "ptp:04a9:3219", "receiving", item="IMG_0043.JPG",
                          done=21_000_000, total=28_000_000)
        self.scene.job(2, self.scene.panel(2, 6, "waiting", age=0))
        after = terminal.wait_for_text("panel 6")
        self.assertIn("75 % of 28.0 MB, IMG_0043.JPG", after)
        self.assertIn("3 waiting", after)
        self.assertNotIn("panel 6", before)
        self.assertIn("8 of 15", after)
        self.scene.scan("copystand", "IMG_0043.JPG", reason="nobody knows", age=0)
        self.assertIn("IMG_0043.JPG     unfiled", terminal.wait_for_text("9 of 16"))
        terminal.press("Enter")
        self.assertTrue(terminal.wait_for_text("any key: back").startswith("panel 4\n"))

    def test_an_import_by_another_program_appears(self):
        terminal = self.open()
        terminal.wait_for_text("gieson --store store import FOLDER")
        self.imported("R12-right", panels=2)
        after = terminal.wait_for_text("panel 2")
        self.assertRegex(after, r"\. R12-right +waiting +0/2 panels +now +run\n")
        self.assertRegex(after, r"  \. panel 1 +waiting +scan_P01\.png +now\n")
        self.assertEqual(self.call("run").returncode, 65)  # withheld
        terminal.wait_for_text("withheld")

    def test_progress_is_followed_to_the_end(self):
        terminal = self.busy()
        began = time.monotonic()
        job = self.scene.db.execute("SELECT id FROM job WHERE stage = 'fit'").fetchone()[0]
        for done, left, told in ((60, 400.0, "fit 60 %, 7 min left"), (99, 5.0, "fit 99 %, 5 s")):
            self.scene.run("UPDATE job SET done = ?, eta_s = ? WHERE id = ?", done, left, job)
            terminal.wait_for_text(told)
        self.scene.run("UPDATE job SET state = 'done' WHERE id = ?", job)
        self.scene.ran(5, loss=12.5)
        terminal.resize(100, 34)
        terminal.wait_for_text("loss 12.50 %")
        # Three changes, each seen because it came and not because ages are told anew now and then.
        self.assertLess(time.monotonic() - began, 30)

    def test_a_chosen_line_that_vanishes_leaves_the_next_one_chosen(self):
        terminal = self.busy(100, 34)
        terminal.press(*["Down"] * 3)
        terminal.wait_for_text("4 of 14")
        self.scene.run("DELETE FROM trouble")
        after = terminal.wait_for_text("of 13")
        self.assertIn("4 of 13", after)
        self.assertIn("next  gieson --store store file", after)

    def test_it_follows_the_size_of_its_terminal(self):
        terminal = self.busy(80, 24)
        terminal.resize(100, 34)
        terminal.wait_for_text("1 of 14")
        self.compare("queue_100x34", terminal.wait_for_text("R07-left"))
        terminal.resize(30, 6)
        terminal.wait_for_text("needs 40 columns")
        terminal.resize(80, 24)
        terminal.wait_for_text("COMES IN")
        self.compare("queue_80x24", terminal.wait_for_text(READY))

    def hold(self, *services):
        file = open(self.store / "giesond.lock", "w", encoding="utf-8")
        self.addCleanup(file.close)
        bench.hold_lock(file, *services)
        return file

    def test_it_says_whether_the_service_is_there(self):
        terminal = self.busy()
        self.assertIn("giesond is not running: nothing comes in", terminal.screen())
        both = self.hold(0, 1)
        terminal.wait_for_text("giesond takes panels in and does the jobs")
        both.close()
        terminal.wait_for_text("giesond is not running")
        with self.hold(0):
            terminal.wait_for_text("giesond takes panels in; only `gieson --store store run` does the jobs")
        with self.hold(1):
            terminal.wait_for_text("giesond does the jobs; nothing comes in by itself")

    def test_the_service_itself_is_seen_to_come_and_go(self):
        terminal = self.open()
        terminal.wait_for_text("giesond is not running")
        self.imported("R07", folder="earlier")
        scans = self.folder / "scans"
        scans.mkdir()
        config = self.folder / "gieson.conf"
        config.write_text(f"[source scanner]\nAddress=hot:{scans}\n", encoding="utf-8")
        service = subprocess.Popen([bench.BIN / "giesond", "--store", str(self.store), "--config",
                                    str(config)], env=self.environment(),
                                   stderr=subprocess.DEVNULL)
        try:
            terminal.wait_for_text("giesond takes panels in and does the jobs")
            terminal.wait_for(lambda screen: re.search(r"(?m)^\+ scanner +ready", screen))
            bench.png(scans / "R07-P07.png", 32, 32, seed=7)
            terminal.wait_for_text("panel 7")
            second = subprocess.run([bench.BIN / "giesond", "--store", str(self.store), "--config",
                                     str(config)], env=self.environment(), check=False,
                                    capture_output=True, encoding="utf-8", timeout=60)
            self.assertEqual(second.returncode, 75)
            self.assertIn("another giesond takes panels in", second.stderr)
        finally:
            service.kill()
            service.wait()
        terminal.wait_for_text("giesond is not running")

    def test_a_store_that_is_gone_is_a_line_and_comes_back(self):
        terminal = self.busy()
        away = self.folder / "away"
        self.store.rename(away)
        gone = terminal.wait_for_text("is not a gieson store")
        self.assertIn("GVP-D-S03", gone)
        terminal.press("Down")
        terminal.wait_for_text("2 of 14")
        away.rename(self.store)
        terminal.wait_for_text("giesond is not running")
        self.scene.run("DELETE FROM trouble")
        terminal.wait_for_text("of 13")

    def test_a_store_that_others_write_is_read_all_the_same_and_a_retry_says_that_it_must_wait(self):
        terminal = self.busy()
        terminal.press(*["Down"] * 5)
        terminal.wait_for_text("6 of 14")
        self.scene.db.execute("BEGIN IMMEDIATE")
        terminal.press("r")
        terminal.wait_for_text("database is locked")
        terminal.press("End")
        terminal.wait_for_text("14 of 14")
        self.scene.db.execute("ROLLBACK")
        terminal.press("R")
        terminal.wait_for_text("1 failed job waits again")

    def test_nothing_happens_and_nothing_is_used(self):
        terminal = self.busy()
        stat = pathlib.Path(f"/proc/{terminal.pid()}/stat")

        def ticks():
            fields = stat.read_text(encoding="ascii").rsplit(")", 1)[1].split()
            return int(fields[11]) + int(fields[12])

        before = ticks()
        time.sleep(3)
        self.assertLessEqual(ticks() - before, 6, "hundredths of a second in three seconds")


class Terminals(Top):
    """Whatever the terminal can or cannot do."""

    def test_colour_where_there_is_colour_and_none_where_it_is_not_wanted(self):
        self.assertRegex(self.busy().screen(escapes=True), COLOUR)
        for before in ("NO_COLOR=1", "TERM=vt100", "TERM=vt220"):
            with self.subTest(before=before):
                terminal = self.open(before=before)
                plain = terminal.wait_for_text(READY)
                self.assertNotRegex(terminal.screen(escapes=True), COLOUR)
                self.compare("queue_80x24", plain)

    def test_a_terminal_without_utf8_gets_marks_and_the_same_columns(self):
        screen = self.busy(utf8=False).screen()
        self.assertTrue(screen.isascii())
        self.assertIn("Gelenk-?7 links  working", screen)

    def test_nothing_in_a_name_reaches_the_terminal_as_a_command(self):
        for name in ODD_NAMES:
            specimen = self.scene.specimen(name)
            self.scene.job(specimen, self.scene.panel(specimen, 1, "waiting", name=name, age=10))
            self.scene.source(name, "hot:" + name, "away", message=name, age=10)
            self.scene.trouble("a", name, name, name, age=10)
            self.scene.scan("a", name, reason=name, age=10)
        terminal = self.open(100, 60)
        screen = terminal.wait_for_text("two?lines")
        self.assertNotIn("title", terminal.tmux("display-message", "-p", "#{pane_title}"))
        self.assertNotIn("31m", re.sub(r"\x1b\[[0-9;]*m", "", terminal.screen(escapes=True))
                         .replace("?[31m", ""))
        at = {columns(line[:line.index("  away  ")]) for line in screen.split("\n")
              if "  away  " in line}
        self.assertEqual(len(at), 1, screen)
        self.assertIn("?turned", screen)
        for _ in range(3 * len(ODD_NAMES)):
            terminal.press("Enter")
            terminal.wait_for_text("any key: back")
            terminal.press("Escape")
            terminal.wait_for_text("? help")
            terminal.press("Down")

    # Case 66.
    def test_what_is_no_terminal_gets_a_table(self):
        self.scene.busy_bench()
        done = self.call("top")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertNotIn("\x1b", done.stdout)
        self.assertIn("giesond is not running", done.stdout)
        self.assertRegex(done.stdout, r"(?m)^x GVP-D-S03 +failed +40 min +no mesh could be made of "
                         r".* import it$")
        self.assertIn("    next: gieson retry GVP-D-S03\n", done.stdout)
        self.assertRegex(done.stdout, r"(?m)^\? IMG_0041\.JPG +unfiled +4 min +no specimen")
        self.assertIn("    next: gieson file ", done.stdout)
        code, screen = self.terminal(100, "top", env={"TERM": "dumb"})
        self.assertEqual(code, 0)
        self.assertNotIn("\x1b", screen)
        self.assertIn("x GVP-D-S03", screen)
        code, screen = self.terminal(100, "top", env={"TERM": "no-such-terminal"})
        self.assertEqual((code, "x GVP-D-S03" in screen), (0, True))


class Many(Top):
    """300 specimens, 5000 panels, long names."""

    def test_it_stays_quick(self):
        db = self.scene.db
        db.execute("BEGIN")
        for i in range(300):
            specimen = self.scene.specimen(f"specimen with a rather long name {i:03}",
                                           group=f"group {i % 7}")
            for number in range(1, 17):
                panel = self.scene.panel(specimen, number, "waiting" if i % 3 else "registered",
                                         age=3600 * i + 10, name="p" * 200 + f"_P{number:02}.tif")
                db.executemany("INSERT INTO section (id, panel_id, slot, serial, state, flags) "
                               "VALUES (?, ?, ?, ?, 'found', '')",
                               [(panel * 4096 + s, panel, s, s) for s in range(1, 13)])
                if i % 3:
                    self.scene.job(specimen, panel)
            self.scene.job(specimen)
        db.execute("COMMIT")
        began = time.monotonic()
        terminal = self.open(100, 34)
        terminal.wait_for_text("1 of ")
        shown = time.monotonic() - began
        terminal.press("End")
        terminal.wait_for_text("3500 of 3500")
        began = time.monotonic()
        self.scene.source("scanner", "hot:/srv", "away", message="the share is gone")
        terminal.press("Home")
        terminal.wait_for_text("the share is gone")
        followed = time.monotonic() - began
        began = time.monotonic()
        self.call("status", "--json")
        status = time.monotonic() - began
        print(f"300 specimens, 4800 panels, 57600 sections: shown after {shown:.2f} s, a change "
              f"after {followed:.2f} s, status {status:.2f} s", file=sys.stderr)
        self.assertLess(shown, 10)
        self.assertLess(followed, 10)


def main():
    global WRITE
    bench.BIN = pathlib.Path(sys.argv[1]).resolve()
    topic = sys.argv[2:]
    if topic == ["--write"]:
        WRITE, topic = True, ["Screens"]
    topic = [".".join(topic)] if topic else []
    result = unittest.main(argv=[sys.argv[0], *topic], exit=False).result
    for test, reason in result.skipped:
        print(f"skipped: {test.id()}: {reason}", file=sys.stderr)
    if not result.wasSuccessful():
        sys.exit(1)
    sys.exit(bench.SKIPPED if result.skipped and len(result.skipped) == result.testsRun else 0)


if __name__ == "__main__":
    main()
