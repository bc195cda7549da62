# SPDX-License-Identifier: AGPL-3.0-or-later
"""test_glass.py REPORT_SAMPLE: the page of large sections in a headless Chromium.

The page is report_sample's: 58 sections of 280 pixels over 3000 um; code 2 (a fold) is masked in a
disc around (600, -150) um, the density is x / 1500 um to the right of the middle and not known to
the left, the region is a disc of 750 um. Section 2.9 has no density. 77: no Chromium."""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

import bench
import browser

SAMPLE = None
FOLD, ORANGE = (600, -150), (213, 94, 0)


class Glass(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.kept = tempfile.TemporaryDirectory(prefix="gieson-glass-")
        cls.addClassCleanup(cls.kept.cleanup)
        subprocess.run([SAMPLE, cls.kept.name], check=True)
        cls.page = pathlib.Path(cls.kept.name) / "sections.html"
        cls.seen = browser.Browser(1280, 900)
        cls.addClassCleanup(cls.seen.close)
        cls.ready(cls.seen)

    @staticmethod
    def ready(seen, address=""):
        seen.open(f"{Glass.page}{address}")
        seen.until("+document.getElementById('glass').dataset.drawn > 0")

    def setUp(self):
        self.go_to("3.7")
        self.wait_drawn("document.getElementById('glass-home').click()")

    def wait_drawn(self, action):
        """Does it and waits until all is drawn anew."""
        drawn = self.seen.ask("document.getElementById('glass').dataset.drawn")
        self.seen.ask(action)
        self.seen.until(f"document.getElementById('glass').dataset.drawn !== '{drawn}'")

    def set_to(self, name, value):
        self.wait_drawn(f"(e => {{ e.value = '{value}'; e.dispatchEvent(new Event('input')); }})"
                        f"(document.getElementById('glass-{name}'))")

    def tick(self, name):
        self.wait_drawn(f"document.getElementById('glass-{name}').click()")

    def press(self, key):
        self.wait_drawn("document.getElementById('glass-view').dispatchEvent("
                        f"new KeyboardEvent('keydown', {{ key: '{key}' }}))")

    def said(self, name="section"):
        return self.seen.ask(f"document.getElementById('glass-{name}-said').textContent")

    def go_to(self, name):
        index = self.seen.ask("[...document.querySelectorAll('#glass-row b')]"
                              f".findIndex(e => e.textContent === '{name}')")
        self.set_to("section", index)
        self.assertTrue(self.said().startswith(name + ","))

    def shown(self, places):
        """The canvas at places of the block."""
        return self.seen.ask("""(places => {
            const view = document.getElementById('glass-view'), to = view.getContext('2d');
            return places.map(([x, y]) => [...to.getImageData(
                Math.floor((x + 1500) / 3000 * view.width),
                Math.floor((y + 1500) / 3000 * view.height), 1, 1).data].slice(0, 3));
        })(%s)""" % json.dumps(places))

    def pictured(self, name, places):
        """The colours of the section's own picture in the page there."""
        return self.seen.ask("""((name, places) => {
            const img = [...document.querySelectorAll('#glass-row figure')].find(
                f => f.querySelector('b').textContent === name).querySelector('img');
            const side = img.naturalWidth;
            const c = Object.assign(document.createElement('canvas'), { width: side, height: side });
            const to = c.getContext('2d', { willReadFrequently: true });
            to.drawImage(img, 0, 0);
            return places.map(([x, y]) => [...to.getImageData(Math.floor((x + 1500) / 3000 * side),
                Math.floor((y + 1500) / 3000 * side), 1, 1).data].slice(0, 3));
        })(%s, %s)""" % (json.dumps(name), json.dumps(places)))

    def assert_colour(self, got, wanted, within=12):
        for a, b in zip(got, wanted):
            self.assertLess(abs(a - b), within, f"{got} is not {wanted}")

    def point_at(self, x, y):
        """Moves the pointer to a place of the block; what is said of it."""
        box = self.seen.ask("(b => [b.x, b.y, b.width])(document.getElementById('glass-view')"
                            ".getBoundingClientRect())")
        self.seen.mouse("mouseMoved", box[0] + (x + 1500) / 3000 * box[2],
                        box[1] + (y + 1500) / 3000 * box[2])
        rows = self.seen.ask("[...document.querySelectorAll('#glass-told dt')].map(e => "
                             "[e.textContent, e.nextSibling.textContent])")
        return {name: value.replace("\u2212", "-") for name, value in rows}

    def test_it_asks_for_nothing_and_goes_by_keys_and_by_its_address(self):
        for key, wanted in (("ArrowRight", "3.8, 31 of 58"), ("ArrowLeft", "3.7, 30 of 58"),
                            ("End", "5.12, 58 of 58"), ("Home", "1.1, 1 of 58")):
            self.press(key)
            self.assertEqual(self.said(), wanted)
        self.assertTrue(self.seen.ask("location.hash") == "#section-0")
        self.wait_drawn("location.hash = '#section-8'")
        self.assertEqual(self.said(), "1.9, 9 of 58")
        self.assertEqual(self.seen.ask("document.querySelector('#glass-told a').getAttribute('href')"),
                         "report.html#section-8")
        self.assertEqual(len([r for r in self.seen.requests if not r.startswith("data:")]), 1)
        self.assertEqual([s for s in self.seen.said if "willReadFrequently" not in s], [])

    def test_a_section_is_shown_as_the_page_holds_it(self):
        places = [(-1400 + 250 * i, -1400 + 250 * j) for i in range(12) for j in range(12)]
        for name in ("1.1", "4.6"):
            self.go_to(name)
            self.tick("marks")
            self.tick("region")
            wrong = 0
            for got, wanted in zip(self.shown(places), self.pictured(name, places)):
                wrong += max(abs(a - b) for a, b in zip(got, wanted)) > 30  # at an edge
            self.assertLess(wrong, 8)
            self.tick("marks")
            self.tick("region")

    def test_the_density_and_what_is_not_measured_lie_where_they_are(self):
        ends = (68, 1, 84), (253, 231, 37)  # viridis
        self.set_to("density", 100)
        low, high, unknown = self.shown([(20, 1300), (1480, 1300), (-200, 1300)])
        self.assert_colour(low, ends[0])
        self.assert_colour(high, ends[1])
        self.assert_colour(unknown, self.pictured("3.7", [(-200, 1300)])[0])
        self.press("m")
        fold, beside = self.shown([FOLD, (600, -600)])
        self.assertLess(max(abs(a - b) for a, b in zip(fold, ORANGE)), 70)  # some of it shines through
        self.assertGreater(max(abs(a - b) for a, b in zip(beside, ORANGE)), 90)
        self.assertIn("fold", self.seen.ask("document.getElementById('glass-told').innerText"))
        told = self.point_at(*FOLD)
        self.assertEqual(told["Not measured"], "fold")
        self.assertAlmostEqual(float(told["Density"]), 0.4, delta=0.02)
        self.assertEqual(told["In the region"], "yes")
        told = self.point_at(1200, 0)
        self.assertNotIn("Not measured", told)
        self.assertAlmostEqual(float(told["Density"]), 0.8, delta=0.02)
        self.assertEqual(told["In the region"], "no")
        x, y = map(float, told["x, y"].replace(" µm", "").split(", "))
        self.assertAlmostEqual(x, 1200, delta=4)
        self.assertAlmostEqual(y, 0, delta=4)
        self.assertEqual(self.point_at(-900, 0)["Density"], "not known")
        self.go_to("2.9")
        self.assertNotIn("Density", self.point_at(1200, 0))

    def test_marks_are_ringed_where_they_lie(self):
        ring = self.seen.ask("getComputedStyle(document.documentElement)"
                             ".getPropertyValue('--fuchsin').trim()")
        wanted = [int(ring[i:i + 2], 16) for i in (1, 3, 5)]
        around = self.seen.ask("""(() => {
            const view = document.getElementById('glass-view'), to = view.getContext('2d');
            const mark = [...document.querySelectorAll('#glass-row figure')].find(
                f => f.querySelector('b').textContent === '3.7').dataset.marks.split(',')[0]
                .split(' ').map(Number);
            const x = (mark[0] + mark[2] + 1500) / 3000 * view.width;
            const y = (mark[1] + mark[3] + 1500) / 3000 * view.height;
            return [16, 40].map(r => [...to.getImageData(Math.floor(x + r), Math.floor(y), 1, 1).data]
                .slice(0, 3));
        })()""")
        self.assert_colour(around[0], wanted, 60)
        self.assertGreater(max(abs(a - b) for a, b in zip(around[1], wanted)), 60)

    def test_neighbours_take_turns(self):
        self.go_to("4.5")
        # 4.6 lies 90 um beside it: somewhere at the edge of the tissue they differ.
        places = [(x, 60) for x in range(-1480, 1490, 20)]
        one, other = (self.pictured(name, places) for name in ("4.5", "4.6"))
        differ = [n for n in range(len(places))
                  if max(abs(a - b) for a, b in zip(one[n], other[n])) > 60]
        self.assertGreater(len(differ), 2)
        self.press("f")
        there = [places[n] for n in differ]
        for wanted in (one, other, one):
            script = json.dumps([wanted[n] for n in differ])
            self.seen.until("""((places, wanted) => {
                const view = document.getElementById('glass-view'), to = view.getContext('2d');
                return places.filter(([x, y], n) => {
                    const got = to.getImageData(Math.floor((x + 1500) / 3000 * view.width),
                        Math.floor((y + 1500) / 3000 * view.height), 1, 1).data;
                    return Math.max(...wanted[n].map((w, c) => Math.abs(w - got[c]))) < 30;
                }).length > places.length / 2;
            })(%s, %s)""" % (json.dumps(there), script), 10)

    def test_enlarged_it_scrolls_and_a_narrow_screen_holds_it(self):
        self.set_to("size", 30)
        wide, inner = self.seen.ask("(s => [s.clientWidth, s.scrollWidth])"
                                    "(document.getElementById('glass-stage'))")
        self.assertGreater(inner, 1.5 * wide)
        with browser.Browser(400, 800) as seen:
            self.ready(seen)
            self.assertEqual(seen.ask("document.documentElement.scrollWidth"), 400)
            self.assertEqual(seen.said, [])

    def test_without_scripts_the_pictures_follow_each_other(self):
        with browser.Browser(1000, 800) as seen:
            seen.tell("Emulation.setScriptExecutionDisabled", value=True)
            seen.open(self.page)
            self.assertTrue(seen.ask("document.getElementById('glass').hidden"))
            shown = seen.ask("[...document.querySelectorAll('#glass-row img')]"
                             ".filter(e => e.offsetHeight > 250).length")
            self.assertEqual(shown, 58)

    def test_the_report_leads_here(self):
        with browser.Browser(1280, 900) as seen:
            seen.open(pathlib.Path(self.kept.name) / "specimen.html")
            seen.ask("document.querySelector('#section-16 a.glass').click()")
            seen.until("location.pathname.endsWith('sections.html') && "
                       "+(document.getElementById('glass') || { dataset: {} }).dataset.drawn > 0")
            self.assertEqual(seen.ask("document.getElementById('glass-section-said').textContent"),
                             "2.5, 17 of 58")


def main():
    global SAMPLE
    SAMPLE = sys.argv[1]
    if not browser.path():
        print("SKIPPED: no chromium: nobody looked at the page of large sections", file=sys.stderr)
        sys.exit(bench.SKIPPED)
    unittest.main(argv=[sys.argv[0]], verbosity=1)


if __name__ == "__main__":
    main()
