# SPDX-License-Identifier: AGPL-3.0-or-later
"""test_alignment.py REPORT_SAMPLE: the page's aligned sections in a headless Chromium.

The page is report_sample's: 58 sections with a place, of which 4.6 lies 90 um beside its own. What
the canvas shows is held against the pictures in the page, pixel by pixel, and arrows against the
places that the page states. 77: no Chromium."""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

import bench
import browser

SAMPLE = None
ASKEW, BEFORE = "4.6", "4.5"


class Alignment(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.kept = tempfile.TemporaryDirectory(prefix="gieson-alignment-")
        cls.addClassCleanup(cls.kept.cleanup)
        subprocess.run([SAMPLE, cls.kept.name], check=True)
        cls.page = pathlib.Path(cls.kept.name) / "specimen.html"
        cls.seen = browser.Browser(1280, 900)
        cls.addClassCleanup(cls.seen.close)
        cls.ready(cls.seen)

    @staticmethod
    def ready(seen):
        seen.open(Alignment.page)
        seen.until("+document.getElementById('align').dataset.drawn > 0")

    @staticmethod
    def wait_drawn(seen, action):
        """Does it and waits until all is drawn anew."""
        drawn = seen.ask("document.getElementById('align').dataset.drawn")
        seen.ask(action)
        seen.until(f"document.getElementById('align').dataset.drawn !== '{drawn}'")

    def set_to(self, seen, name, value):
        self.wait_drawn(seen, f"(e => {{ e.value = '{value}'; e.dispatchEvent(new Event('input')); }})"
                              f"(document.getElementById('align-{name}'))")

    def press(self, seen, key):
        self.wait_drawn(seen, "document.getElementById('align-view').dispatchEvent("
                              f"new KeyboardEvent('keydown', {{ key: '{key}' }}))")

    @staticmethod
    def said(seen, name="section"):
        return seen.ask(f"document.getElementById('align-{name}-said').textContent")

    def go_to(self, seen, name):
        index = seen.ask("[...document.querySelectorAll('#align-row b')]"
                         f".findIndex(e => e.textContent === '{name}')")
        self.set_to(seen, "section", index)
        self.assertTrue(self.said(seen).startswith(name + ","))

    @staticmethod
    def shown(seen, places):
        """The canvas around each place of the block: five pixels by five, three numbers each."""
        return seen.ask("""(places => {
            const view = document.getElementById('align-view');
            const d = document.getElementById('align').dataset, wide = 3000;
            const s = Math.min(view.width, view.height) / wide, to = view.getContext('2d');
            return places.map(([x, y]) => {
                const p = to.getImageData(Math.round(view.width / 2 + (x - d.x - wide / 2) * s) - 2,
                    Math.round(view.height / 2 + (y - d.y - wide / 2) * s) - 2, 5, 5).data;
                return Array.from({ length: 25 }, (_, n) => [...p.slice(4 * n, 4 * n + 3)]);
            });
        })(%s)""" % json.dumps(places))

    @staticmethod
    def pictured(seen, name, places):
        """The colours of the section's own picture in the page there."""
        return seen.ask("""((name, places) => {
            const img = [...document.querySelectorAll('#align-row figure')].find(
                f => f.querySelector('b').textContent === name).querySelector('img');
            const d = document.getElementById('align').dataset, side = img.naturalWidth;
            const c = Object.assign(document.createElement('canvas'), { width: side, height: side });
            const to = c.getContext('2d', { willReadFrequently: true });
            to.drawImage(img, 0, 0);
            return places.map(([x, y]) => [...to.getImageData(Math.floor((x - d.x) / d.um),
                Math.floor((y - d.y) / d.um), 1, 1).data].slice(0, 3));
        })(%s, %s)""" % (json.dumps(name), json.dumps(places)))

    def assert_colour(self, got, wanted, within=14):
        """The middle one of five pixels by five."""
        for a, b in zip(got[12], wanted):
            self.assertLess(abs(a - b), within, f"{got[12]} is not {wanted}")

    @staticmethod
    def nearest(got, wanted):
        """How near the nearest of the pixels comes to a colour."""
        return min(max(abs(a - b) for a, b in zip(pixel, wanted)) for pixel in got)

    def test_it_asks_for_nothing_and_scrolls_by_keys(self):
        seen = self.seen
        self.press(seen, "0")
        self.assertTrue(seen.ask("document.getElementById('align-row').hidden"))
        self.assertEqual(self.said(seen), "3.7, 30 of 58")  # 3.6 was not delivered
        for key, wanted in (("ArrowRight", "3.8, 31 of 58"), ("ArrowLeft", "3.7, 30 of 58"),
                            ("PageDown", "4.5, 40 of 58"), ("End", "5.12, 58 of 58"),
                            ("Home", "1.1, 1 of 58"), ("0", "3.7, 30 of 58")):
            self.press(seen, key)
            self.assertEqual(self.said(seen), wanted)
        told = seen.ask("document.getElementById('align-told').innerText")
        self.assertIn("Section 3.7", told)
        self.assertIn("Shown with 3.8, 24 µm behind it.", told)
        self.assertEqual(len([r for r in seen.requests if not r.startswith("data:")]), 1)
        # Chromium's advice to this test, which reads the canvas.
        self.assertEqual([s for s in seen.said if "willReadFrequently" not in s], [])

    def test_a_finger_scrolls_and_two_enlarge(self):
        with browser.Browser(400, 800) as seen:
            self.ready(seen)
            self.assertEqual(seen.ask("document.documentElement.scrollWidth"), 400)
            seen.ask("document.getElementById('align-view').scrollIntoView({block: 'center', "
                     "behavior: 'instant'})")
            x, y, wide, high = seen.ask("(b => [b.x, b.y, b.width, b.height])(document."
                                        "getElementById('align-view').getBoundingClientRect())")
            seen.tell("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)

            def touch(kind, *points):
                seen.tell("Input.dispatchTouchEvent", type=kind, touchPoints=[
                    {"x": x + wide * p, "y": y + high * q, "id": i}
                    for i, (p, q) in enumerate(points)])

            touch("touchStart", (0.8, 0.5))
            for step in range(1, 9):
                touch("touchMove", (0.8 - 0.05 * step, 0.5))
            touch("touchEnd")
            seen.until("document.getElementById('align-section-said').textContent.startsWith('4')")
            touch("touchStart", (0.4, 0.5), (0.6, 0.5))
            for step in range(1, 5):
                touch("touchMove", (0.4 - 0.05 * step, 0.5), (0.6 + 0.05 * step, 0.5))
            touch("touchEnd")
            seen.until("document.getElementById('align-view').classList.contains('near')")
            self.assertEqual(seen.said, [])

    def test_squares_show_the_one_and_the_other_by_turns(self):
        places = [(-1500 + 375 * (i + 0.5), -1480 + 375 * (j + 0.5))
                  for i in range(8) for j in range(8)]
        seen = self.seen
        self.press(seen, "0")
        self.wait_drawn(seen, "document.getElementById('align-arrows').click()")
        self.go_to(seen, BEFORE)
        shown, told = self.shown(seen, places), 0
        both = [self.pictured(seen, name, places) for name in (BEFORE, ASKEW)]
        for n, got in enumerate(shown):
            if max(abs(a - b) for a, b in zip(both[0][n], both[1][n])) < 30:
                continue
            self.assert_colour(got, both[(n // 8 + n % 8) % 2][n])
            told += 1
        self.assertGreater(told, 3)  # the two differ there
        self.set_to(seen, "show", "alone")
        for got, wanted in zip(self.shown(seen, places), both[0]):
            self.assertLess(self.nearest(got, wanted), 14)

    def test_two_colours_are_grey_where_both_agree_and_not_where_one_lies_askew(self):
        def dark(rgb):
            return (54 * rgb[0] + 183 * rgb[1] + 19 * rgb[2]) / 256

        places = [(x, 60) for x in range(-1300, 1400, 15)]
        seen = self.seen
        self.press(seen, "0")
        self.wait_drawn(seen, "document.getElementById('align-arrows').click()")
        self.set_to(seen, "show", "colours")
        for name, other in (("3.7", "3.8"), (BEFORE, ASKEW)):
            self.go_to(seen, name)
            shown = [pixels[12] for pixels in self.shown(seen, places)]
            own, with_ = ([dark(c) for c in self.pictured(seen, n, places)] for n in (name, other))
            for n in range(2, len(places) - 2):
                if max(max(v[n - 2:n + 3]) - min(v[n - 2:n + 3]) for v in (own, with_)) < 4:
                    for got, wanted in zip(shown[n], (with_[n], own[n], with_[n])):
                        self.assertLess(abs(got - wanted), 6)
            most = max(abs(red - green) for red, green, _ in shown)
            if other == ASKEW:
                self.assertGreater(most, 40)
            else:
                self.assertLess(most, 12)

    def test_arrows_point_where_the_marks_lie_at_the_scale_that_is_told(self):
        seen = self.seen
        self.press(seen, "0")
        self.set_to(seen, "show", "alone")
        inks = [[int(c[i:i + 2], 16) for i in (1, 3, 5)] for c in seen.ask(
            "['--fuchsin', '--picric', '--blue'].map(n => getComputedStyle("
            "document.documentElement).getPropertyValue(n).trim())")]
        told = seen.ask("document.getElementById('align-told').innerText")
        times = float(told.split("Arrows are ")[1].split()[0])
        for name in ("1.1", "2.3", "5.6"):
            self.go_to(seen, name)
            marks = seen.ask("[...document.querySelectorAll('#align-row figure')].find(f => "
                             f"f.querySelector('b').textContent === '{name}').dataset.marks")
            for ink, mark in zip(inks, marks.split(",")):
                x, y, dx, dy = map(float, mark.split())
                tip, beyond = ((x + times * far * dx, y + times * far * dy) for far in (0.97, 1.7))
                at_tip, further = self.shown(seen, [tip, beyond])
                self.assertLess(self.nearest(at_tip, ink), 12)
                self.assertGreater(self.nearest(further, ink), 20)
        self.wait_drawn(seen, "document.getElementById('align-arrows').click()")
        self.assertGreater(self.nearest(self.shown(seen, [tip])[0], ink), 20)

    def test_without_scripts_the_pictures_lie_side_by_side(self):
        with browser.Browser(1000, 800) as seen:
            seen.tell("Emulation.setScriptExecutionDisabled", value=True)
            seen.open(self.page)
            self.assertTrue(seen.ask("document.getElementById('align').hidden"))
            row = seen.ask("(e => [e.children.length, e.offsetHeight, e.hidden])"
                           "(document.getElementById('align-row'))")
            self.assertEqual(row[0], 58)
            self.assertGreater(row[1], 150)
            self.assertFalse(row[2])


def main():
    global SAMPLE
    SAMPLE = sys.argv[1]
    if not browser.path():
        print("SKIPPED: no chromium: nobody looked at the page's aligned sections", file=sys.stderr)
        sys.exit(bench.SKIPPED)
    unittest.main(argv=[sys.argv[0]], verbosity=1)


if __name__ == "__main__":
    main()
