#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The report's page in a browser: the model that is turned, cut and asked in it.

    test_page.py BIN Viewer Colours      exit 77 (skipped) without Chromium

The specimen of Viewer is a block of 32 x 32 x 24 voxels with a ball of high density in it, one corner
empty; that of Colours is a phantom's sections.
"""
import base64
import csv
import math
import pathlib
import re
import struct
import sys
import tempfile
import time
import unittest
import zlib

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import bench
import browser

SIDE, HIGH, STEP = 32, 24, 10.0
CELLS = 10  # that are asked


def value(x, y, z):
    r = math.dist((x, y, z), (16, 15, 11))
    return 0.15 + 0.7 / (1 + math.exp((r - 8) / 1.2)) + 0.002 * x


def write_volume(path):
    head = (f"NRRD0004\ntype: float\nendian: little\ndimension: 3\nspace dimension: 3\n"
            f"sizes: {SIDE} {SIDE} {HIGH}\nspace directions: ({STEP},0,0) (0,{STEP},0) "
            f"(0,0,{STEP})\nspace origin: (-50,100,20)\nspace units: \"um\" \"um\" \"um\"\n"
            "encoding: raw\n\n")
    voxels = [math.nan if x < 9 and y < 9 else value(x, y, z)
              for z in range(HIGH) for y in range(SIDE) for x in range(SIDE)]
    path.write_bytes(head.encode() + struct.pack(f"<{len(voxels)}f", *voxels))


class Page(bench.Bench):
    """One specimen, worked once, and its page."""
    @classmethod
    def work(cls, *commands):
        cls.kept = tempfile.TemporaryDirectory(prefix="gieson-page-")
        cls.addClassCleanup(cls.kept.cleanup)
        worker = cls("call")
        worker.folder = pathlib.Path(cls.kept.name)
        worker.store = worker.folder / "store"
        cls.prepare(worker.folder)
        for command in (*commands, ["run"]):
            done = worker.call(*[str(word).format(worker.folder) for word in command])
            assert done.returncode == 0, done.stderr
        cls.page = next(worker.store.glob("reports/*/*/report.html"))
        return worker

    @classmethod
    def prepare(cls, folder):
        pass

    def setUp(self):
        super().setUp()
        self.store = pathlib.Path(self.kept.name) / "store"

    @classmethod
    def open_page(cls, seen):
        """Opens it and scrolls to the model; the box of its canvas."""
        seen.open(cls.page)
        seen.until("+document.getElementById('viewer').dataset.drawn > 0")
        seen.ask("document.getElementById('viewer-model').scrollIntoView({block: 'center', "
                 "behavior: 'instant'})")
        return seen.ask("(b => [b.x, b.y, b.width, b.height])(document.getElementById("
                        "'viewer-model').getBoundingClientRect())")

    @staticmethod
    def set_to(seen, **values):
        for name, value in values.items():
            seen.ask(f"(e => {{ e.value = '{value}'; e.dispatchEvent(new Event('input')); }})"
                     f"(document.getElementById('viewer-{name}'))")

    @staticmethod
    def look_along_z(seen):
        for _ in range(20):
            seen.ask("document.getElementById('viewer-model').dispatchEvent(new KeyboardEvent("
                     "'keydown', { key: 'ArrowDown' }))")

    def colour_at(self, seen, x, y):
        """Of a pixel of the window, as the browser itself reads a picture of it."""
        file = self.folder / "seen.png"
        seen.picture(str(file))
        data = base64.b64encode(file.read_bytes()).decode()
        return seen.ask(f"""(async () => {{
            const image = new Image();
            image.src = "data:image/png;base64,{data}";
            await image.decode();
            const canvas = document.createElement("canvas");
            canvas.width = image.width;
            canvas.height = image.height;
            const to = canvas.getContext("2d");
            to.drawImage(image, 0, 0);
            return [...to.getImageData({round(x)}, {round(y)}, 1, 1).data].slice(0, 3);
        }})()""")

    @staticmethod
    def read_cell(seen):
        """What the page says of the cell that is chosen; None: none is."""
        head = seen.ask("(document.querySelector('#viewer-cell h3') || {}).textContent")
        if not head:
            return None
        rows = seen.ask("[...document.querySelectorAll('#viewer-cell dt')].map(e => "
                        "[e.textContent, e.nextSibling.textContent])")
        said = {name: value.replace("\u2212", "-") for name, value in rows}
        said["number"] = int(head.split()[1])
        return said


class Viewer(Page):
    @classmethod
    def prepare(cls, folder):
        write_volume(folder / "ball.nrrd")

    @classmethod
    def setUpClass(cls):
        worker = cls.work(["import", "--volume", "{}/ball.nrrd", "--specimen", "ball"])
        table = worker.folder / "units.csv"
        assert worker.call("export", "ball", str(table)).returncode == 0
        with open(table, newline="", encoding="utf-8") as file:
            cls.units = list(csv.DictReader(file))

    def check_cell(self, said):
        """Against the exported table and the probe, digit for digit."""
        row = self.units[said["number"]]
        middle = [row[c] for c in ("x_um", "y_um", "z_um")]
        probe = self.json("probe", "ball", *middle)
        cell = probe["cell"]
        self.assertEqual(cell["number"], said["number"])
        digits = len(said["Mean density"].partition(".")[2])
        self.assertGreaterEqual(digits, 4)
        self.assertEqual(said["Mean density"], f"{float(row['density']):.{digits}f}")
        unit = 10 ** digits
        self.assertEqual(said["Certainly above"],
                         f"{math.floor(cell['lower'] * unit) / unit:.{digits}f}")
        self.assertEqual(said["Certainly below"],
                         f"{math.ceil(cell['upper'] * unit) / unit:.{digits}f}")
        self.assertEqual(said["Samples"], row["samples"])
        self.assertEqual(said["Their residual, rms"], f"{float(row['residual']):.{digits}f}"
                         if row["residual"] else "not known")
        self.assertEqual(said["Volume"], f"{float(row['volume_um3']):.0f} µm³")
        self.assertEqual(said["In the region"], f"{100 * float(row['inside_share']):.1f} %")
        place = [int(v) for v in re.findall(r"-?\d+", said["Middle, µm"])]
        for got, wanted in zip(place, middle):
            self.assertLess(abs(got - float(wanted)), 0.6)

    def test_ten_cells_that_are_clicked_show_the_models_own_figures(self):
        seen_cells = {}
        with browser.Browser(1280, 900) as seen:
            x, y, wide, high = self.open_page(seen)
            for shrink in (100, 70):
                self.set_to(seen, shrink=shrink)
                for i in range(60):
                    if len(seen_cells) >= CELLS * (2 if shrink < 100 else 1):
                        break
                    seen.click(x + wide * (0.3 + 0.4 * (i * 0.618 % 1)),
                               y + high * (0.3 + 0.4 * (i * 0.755 % 1)))
                    said = self.read_cell(seen)
                    if said:
                        seen_cells[said["number"]] = said
            self.assertGreaterEqual(len(seen_cells), 2 * CELLS)
            self.assertEqual([r for r in seen.requests if not r.startswith(("file:", "data:"))], [])
            self.assertEqual(len([r for r in seen.requests if r.startswith("file:")]), 1)
            self.assertEqual(seen.said, [])
        for said in list(seen_cells.values())[:CELLS] + list(seen_cells.values())[-2:]:
            self.check_cell(said)

    def test_the_cell_on_the_cut_is_the_one_that_lies_there(self):
        """Seen straight along z: the pixel says where, and the cell must be the probe's."""
        with browser.Browser(1000, 800) as seen:
            x, y, wide, high = self.open_page(seen)
            self.set_to(seen, cut="z", place=500)
            self.look_along_z(seen)
            place = seen.ask("document.getElementById('viewer-place-said').textContent")
            z = float(re.search(r"-?\d+", place.replace("\u2212", "-")).group())
            seen.click(x + wide / 2, y + high / 2)
            said = self.read_cell(seen)
        self.assertIsNotNone(said)
        numbers = [[float(u[c]) for u in self.units if u["density"]] for c in ("x_um", "y_um")]
        middle = [(min(n) + max(n)) / 2 for n in numbers]
        # The middle of the cells' middles is within a cell of that of the box.
        middle_said = [int(v) for v in re.findall(r"-?\d+", said["Middle, µm"])]
        self.assertLess(math.dist(middle_said, [*middle, z]), 80)

    def seen_along(self, low, high, opacity, least, most):
        """Emission and absorption along z through the middle, over white: the integral itself."""
        ends = (68, 1, 84), (33, 145, 140), (253, 231, 37)  # viridis at 0, 1/2 and 1, for the sum
        steps, radius = 4000, STEP * math.hypot(SIDE, SIDE, HIGH) / 2
        thick = -math.log(1 - opacity / 100) / (0.2 * radius)
        dz, shine, left = STEP * HIGH / steps, 0.0, 1.0
        for i in range(steps):
            v = value(15.5, 15.5, HIGH - 0.5 - (i + 0.5) * HIGH / steps)
            t = min(1, max(0, (v - low) / (high - low)))
            if not least <= t <= most:
                continue
            share = 1 - math.exp(-thick * t * dz)
            k, part = min(1, int(2 * t)), 2 * t - min(1, int(2 * t))
            shine += left * share * (ends[k][1] + part * (ends[k + 1][1] - ends[k][1]))
            left *= 1 - share
        return shine + 255 * left  # of green

    def test_what_is_seen_through_is_the_integral_along_the_ray(self):
        packed = re.search(r'id="viewer-data">([^<]*)<', self.page.read_text(encoding="utf-8")).group(1)
        low, high = struct.unpack("<16d", zlib.decompress(base64.b64decode(packed))[:128])[13:15]
        self.assertLess(low, 0.3)
        self.assertGreater(high, 0.7)
        with browser.Browser(1000, 800) as seen:
            x, y, wide, tall = self.open_page(seen)
            self.set_to(seen, cut="none")
            self.look_along_z(seen)
            for opacity, least in ((10, 0), (30, 0), (70, 0), (30, 0.6)):
                drawn = int(seen.ask("document.getElementById('viewer').dataset.drawn"))
                self.set_to(seen, **{"opacity": opacity, "from": round(1000 * least)})
                seen.until(f"+document.getElementById('viewer').dataset.drawn > {drawn}")
                time.sleep(0.4)  # it draws fewer pixels while it moves
                got = self.colour_at(seen, x + wide / 2, y + tall / 2)
                wanted = self.seen_along(low, high, opacity, least, 1)
                self.assertLess(abs(got[1] - wanted), 12, f"{got} where {wanted:.0f} is true")
            self.set_to(seen, **{"opacity": 100, "from": 0})
            self.assertEqual(seen.ask("document.getElementById('viewer-opacity-said').textContent"),
                             "solid")
            self.assertEqual(seen.said, [])

    def test_levels_bound_the_volume_of_a_cell(self):
        with browser.Browser(1000, 800) as seen:
            x, y, wide, high = self.open_page(seen)
            self.set_to(seen, **{"from": 500})
            checked = 0
            for number in range(0, len(self.units), max(1, len(self.units) // 40)):
                seen.ask("(e => { e.value = '%d'; e.dispatchEvent(new Event('change')); })"
                         "(document.getElementById('viewer-number'))" % number)
                said = self.read_cell(seen)
                if not said or said["number"] != number:
                    continue
                name = next(n for n in said if n.startswith("Above"))
                low, high_ = map(int, re.fullmatch(r"(\d+) to (\d+) µm³", said[name]).groups())
                volume = float(self.units[number]["volume_um3"])
                self.assertLessEqual(low, high_)
                self.assertLessEqual(high_, volume + 1)
                level = float(name.split()[1])
                if float(said["Certainly above"]) > level:
                    self.assertGreaterEqual(high_, math.floor(volume))
                if float(said["Certainly below"]) < level:
                    self.assertEqual(low, 0)
                checked += 1
            self.assertGreater(checked, 10)
            self.assertEqual(seen.said, [])

    def test_the_page_fits_a_phone_and_the_keys_turn_the_model(self):
        with browser.Browser(400, 800) as seen:
            self.open_page(seen)
            self.assertEqual(seen.ask("document.documentElement.scrollWidth"), 400)
            drawn = int(seen.ask("document.getElementById('viewer').dataset.drawn"))
            seen.ask("document.getElementById('viewer-model').focus()")
            seen.tell("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft")
            seen.until(f"+document.getElementById('viewer').dataset.drawn > {drawn}")
            self.assertEqual(seen.said, [])

    def test_what_has_no_colours_offers_none(self):
        with browser.Browser(1000, 800) as seen:
            self.open_page(seen)
            self.assertTrue(seen.ask("document.getElementById('viewer-true').offsetParent === null"))

    def test_without_webgl_a_sentence_stands_in_for_it(self):
        with browser.Browser(1000, 800) as seen:
            seen.tell("Page.addScriptToEvaluateOnNewDocument", source="""
                HTMLCanvasElement.prototype.getContext = () => null;""")
            seen.open(self.page)
            self.assertTrue(seen.ask("document.getElementById('viewer').hidden"))
            self.assertIn("WebGL2", seen.ask("document.getElementById('viewer-none').innerText"))
            self.assertGreater(seen.ask("document.querySelectorAll('#pictures img').length"), 3)

    def test_the_page_weighs_no_more_than_is_promised(self):
        self.assertLess(self.page.stat().st_size, 4e6)


class Colours(Page):
    @classmethod
    def setUpClass(cls):
        cls.work(["phantom", "--specimen", "S00", "--level", "L0", "--seed", "1", "--px", "32",
                  "--out", "{}/scans"], ["import", "{}/scans"])

    def test_true_colour_on_a_cut_is_that_of_the_model(self):
        """Seen straight along z, where no light falls on the cut: the probe's colour of the cell."""
        with browser.Browser(1000, 800) as seen:
            x, y, wide, high = self.open_page(seen)
            self.set_to(seen, cut="z", place=500)
            self.look_along_z(seen)
            checked = 0
            for dx, dy in ((0.1, 0.05), (-0.1, 0.1), (0.05, -0.1)):
                at = (x + wide * (0.5 + dx), y + high * (0.5 + dy))
                seen.click(*at)
                said = self.read_cell(seen)
                if not said:
                    continue
                seen.ask("document.getElementById('viewer-model').dispatchEvent(new KeyboardEvent("
                         "'keydown', { key: 'Escape' }))")
                pixel = []
                for _ in range(2):
                    drawn = int(seen.ask("document.getElementById('viewer').dataset.drawn"))
                    seen.ask("document.getElementById('viewer-true').click()")
                    seen.until(f"+document.getElementById('viewer').dataset.drawn > {drawn}")
                    pixel.append(self.colour_at(seen, *at))
                middle = re.findall(r"-?\d+", said["Middle, µm"])
                code = self.json("probe", "GVP-D-S00", *middle)["colour"]
                wanted = [int(code[k:k + 2], 16) for k in (1, 3, 5)]
                # The pixel is somewhere in the cell, the probe in its middle.
                self.assertLess(math.dist(pixel[0], wanted), 40)
                self.assertGreater(math.dist(pixel[1], wanted), 60)
                checked += 1
            self.assertGreater(checked, 1)
            self.assertEqual(seen.said, [])


def main():
    bench.BIN = pathlib.Path(sys.argv[1]).resolve()
    if not browser.path():
        print("SKIPPED: no chromium: nobody looked at the report's page", file=sys.stderr)
        sys.exit(bench.SKIPPED)
    unittest.main(argv=[sys.argv[0], *sys.argv[2:]], verbosity=1)


if __name__ == "__main__":
    main()
