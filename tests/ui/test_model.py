#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The model of a run from the shell: export, probe, line, integral.

    test_model.py BIN CLASS...   any of these, on one store
      Closed     values against the closed forms of a linear field
      Refusals   what is refused, and in which words
      Readers    the files as VTK and numpy read them; exit 77 (skipped) without python3-vtk9 or
                 python3-numpy, which belong to Debian's Python

The specimen is a cube of 24 x 24 x 24 voxels of 10 um with s = 0.1 + 0.002 x + 0.001 y - 0.0005 z,
so that every figure has a closed form. The fit follows it to some 1e-5, at the region's border to
2e-3.
"""
import contextlib
import csv
import gzip
import json
import math
import pathlib
import shutil
import struct
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import bench

SIDE, STEP = 24, 10.0
LOW, HIGH = -STEP / 2, SIDE * STEP - STEP / 2  # of the region along each axis
SLOPE, CONSTANT = (0.002, 0.001, -0.0005), 0.1
FIT = 1e-4  # what the fit may be off by
BORDER = 3e-3  # at the border of the region
POINT = (101.0, 97.0, 93.0)
MISSING = []  # why the outside readers cannot be asked

try:
    import numpy
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError as reason:
    MISSING.append(str(reason))


def field(x, y, z):
    return CONSTANT + SLOPE[0] * x + SLOPE[1] * y + SLOPE[2] * z


def write_volume(path, side=SIDE):
    head = (f"NRRD0004\ntype: float\nendian: little\ndimension: 3\nspace dimension: 3\n"
            f"sizes: {side} {side} {side}\nspace directions: ({STEP},0,0) (0,{STEP},0) (0,0,{STEP})\n"
            "space origin: (0,0,0)\nspace units: \"um\" \"um\" \"um\"\nencoding: raw\n\n")
    at = [STEP * i for i in range(side)]
    values = [field(x, y, z) for z in at for y in at for x in at]
    path.write_bytes(head.encode() + struct.pack(f"<{len(values)}f", *values))


class Model(bench.Bench):
    """One store for all tests: they read it."""
    kept = None

    @classmethod
    def setUpClass(cls):
        if Model.kept:
            return
        Model.kept = tempfile.TemporaryDirectory(prefix="gieson-model-")
        write_volume(pathlib.Path(cls.kept.name) / "block.nrrd")
        write_volume(pathlib.Path(cls.kept.name) / "half.nrrd", SIDE // 2)
        worker = cls("call")
        worker.folder = pathlib.Path(cls.kept.name)
        worker.store = worker.folder / "store"
        for command in (["import", "--volume", str(worker.folder / "block.nrrd"), "--specimen",
                         "block"],
                        ["import", "--volume", str(worker.folder / "half.nrrd"), "--specimen",
                         "half"], ["run"]):
            done = worker.call(*command)
            assert done.returncode == 0, done.stderr

    def setUp(self):
        super().setUp()
        self.store = pathlib.Path(self.kept.name) / "store"

    def ask(self, *args):
        return self.json(*[str(arg) for arg in args])

    def export(self, name, *options):
        """The path of a file that was written, and what was said of it."""
        path = self.folder / name
        return path, self.ask("export", "block", path, *options)

    def near(self, got, wanted, within=FIT):
        self.assertLess(abs(got - wanted), within, f"{got} is not {wanted}")


class Closed(Model):
    def test_a_probe_has_value_gradient_and_bounds(self):
        said = self.ask("probe", "block", *POINT)
        self.near(said["value"], field(*POINT))
        for got, wanted in zip(said["gradient_per_um"], SLOPE):
            self.near(got, wanted, 1e-5)
        for got in said["hessian_per_um2"]:
            self.near(got, 0, 1e-5)
        self.assertIs(said["in_region"], True)
        self.assertIsNone(said["colour"])  # a volume has none
        cell = said["cell"]
        self.assertLessEqual(cell["lower"], said["value"])
        self.assertGreaterEqual(cell["upper"], said["value"])
        self.assertGreater(cell["samples"], 0)
        self.assertLess(cell["residual"], FIT)

    def test_a_probe_beyond_the_region_says_so(self):
        for y in range(0, 240, 10):  # half a voxel beyond it; not every cell there has a sample
            said = self.ask("probe", "block", -10, y, 100)
            self.assertIs(said["in_region"], False)
            if said["cell"]["samples"] == 0:
                break
        words = self.call("probe", "block", "-10", str(y), "100").stdout
        self.assertIn("beyond the region of interest", words)
        self.assertIn("no sample: the value is made up", words)

    def test_a_line_has_the_integral_of_a_linear_function(self):
        said = self.ask("line", "block", -50, 100, 90, 400, 100, 90, "--points", 10)
        middle = field((LOW + HIGH) / 2, 100, 90)
        self.near(said["region"]["length_um"], HIGH - LOW, 1e-9)
        self.near(said["region"]["mean"], middle)
        self.near(said["region"]["integral_um"], middle * (HIGH - LOW), FIT * (HIGH - LOW))
        self.assertGreater(said["domain"]["length_um"], HIGH - LOW)
        self.assertEqual(len(said["profile"]), 10)
        self.assertIsNone(said["profile"][-1]["value"])
        for row in said["profile"]:
            if row["in_region"]:
                self.near(row["value"], field(*row["at_um"]))

    def test_a_line_does_not_know_where_it_starts(self):
        there = self.ask("line", "block", 10, 20, 30, 150, 120, 90)
        back = self.ask("line", "block", 150, 120, 90, 10, 20, 30)
        self.near(there["region"]["integral_um"], back["region"]["integral_um"], 1e-9)

    def test_the_integral_over_the_region_is_the_reports(self):
        said = self.ask("integral", "block", "--level", 0.3, "--level", 0.6)
        report = json.loads(self.call("report", "block", "--json").stdout)
        # The report rounds to nine digits.
        self.near(said["volume_mm3"], report["region"]["volume_mm3"], 1e-9)
        self.near(said["mean"], report["region"]["mean_density"], 1e-8)
        self.near(said["mean"], field(*[(LOW + HIGH) / 2] * 3))
        for row in said["volumes"]:
            self.assertLessEqual(row["lower_mm3"], row["upper_mm3"])
            truth = self.volume_above(row["level"])
            self.assertLess(row["lower_mm3"], truth * (1 + 1e-3))
            self.assertGreater(row["upper_mm3"], truth * (1 - 1e-3))

    @staticmethod
    def volume_above(level):
        """Of the cube, in mm3: inclusion and exclusion over corners, for a linear function."""
        side = HIGH - LOW
        low = field(LOW, LOW, LOW)
        # Mirror z so that all slopes rise; the function is then low' + sum of |slope| u.
        rise = [abs(s) for s in SLOPE]
        low += SLOPE[2] * side
        total = 0
        for corner in range(8):
            bits = [corner >> c & 1 for c in range(3)]
            left = level - low - side * sum(r * b for r, b in zip(rise, bits))
            total += (-1) ** sum(bits) * max(0, left) ** 3
        return 1e-9 * (side ** 3 - total / (6 * math.prod(rise)))

    def test_boxes_side_by_side_add_up(self):
        whole = self.ask("integral", "block", "--level", 0.4)
        parts = [self.ask("integral", "block", "--level", 0.4, "--box", box)
                 for box in ("-99,-99,-99,100,999,999", "100,-99,-99,999,999,999")]
        for key in ("voxels", "volume_mm3", "integral_mm3"):
            self.near(sum(part[key] for part in parts), whole[key], 1e-12)
        lower, upper = (sum(part["volumes"][0][key] for part in parts)
                        for key in ("lower_mm3", "upper_mm3"))
        self.assertLessEqual(lower, whole["volumes"][0]["upper_mm3"])
        self.assertGreaterEqual(upper, whole["volumes"][0]["lower_mm3"])

    def test_a_plane_across_the_diagonal_is_a_hexagon(self):
        said = self.ask("integral", "block", "--plane", "100,100,100,1,1,1")
        side, reach = HIGH - LOW, 300 - 3 * LOW
        area = math.sqrt(3) / 2 * (reach ** 2 - 3 * (reach - side) ** 2)
        self.near(said["area_mm2"], 1e-6 * area, 1e-12)
        # By symmetry the mean of each coordinate is the same.
        self.near(said["mean"], field(100, 100, 100))

    def test_a_plane_between_voxels_counts_once(self):
        for normal in ("0,0,1", "0,0,-1"):
            said = self.ask("integral", "block", "--plane", f"0,0,95,{normal}")
            self.near(said["area_mm2"], 1e-6 * (HIGH - LOW) ** 2, 1e-12)

    def test_the_whole_domain_names_its_empty_cells(self):
        said = self.ask("integral", "block", "--whole")
        self.assertGreater(said["volume_mm3"], self.ask("integral", "block")["volume_mm3"])
        self.assertGreater(said["cells_without_samples"], 0)

    def test_the_table_of_cells_is_the_models(self):
        path, _ = self.export("units.csv")
        rows = list(csv.DictReader(path.read_text().splitlines()))
        said = self.ask("integral", "block", "--whole")
        self.assertEqual(len(rows), said["cells"])
        self.near(sum(float(row["volume_um3"]) for row in rows) * 1e-9, said["volume_mm3"], 1e-12)
        self.assertEqual(sum(row["samples"] == "0" for row in rows), said["cells_without_samples"])
        self.assertEqual(sum(int(row["samples"]) for row in rows), SIDE ** 3)
        for row in rows:
            if float(row["inside_share"]) > 0.999 and int(row["samples"]) > 100:
                self.near(float(row["density"]),
                          field(*(float(row[c]) for c in ("x_um", "y_um", "z_um"))))

    def test_no_empty_cell_counts_as_within_the_tolerance(self):
        path, _ = self.export("units.csv")
        rows = list(csv.DictReader(path.read_text().splitlines()))
        fit = json.loads(self.call("report", "block", "--json").stdout)["fit"]
        filled = [row for row in rows if row["samples"] != "0"]
        self.assertEqual(fit["tets"], len(rows))
        self.assertEqual(fit["empty_tets"], len(rows) - len(filled))
        self.assertEqual(fit["tets_in_tolerance"],
                         sum(float(row["residual"]) <= fit["tolerance"] for row in filled))

    def test_the_kept_file_is_copied_to_the_last_bit(self):
        path, _ = self.export("model.vtkhdf")
        kept = next(self.store.glob("reports/block/[0-9a-f]*/model.vtkhdf"))
        self.assertEqual(path.read_bytes(), kept.read_bytes())

    def test_the_same_export_is_the_same_bytes(self):
        for name, *options in (["a.nii.gz"], ["a.stl", "--level", 0.3], ["a.vtu"], ["a.csv"]):
            first, _ = self.export(name, *options)
            second, _ = self.export("again_" + name, *options, "--threads", 1)
            self.assertEqual(first.read_bytes(), second.read_bytes())

    def test_the_same_picture_is_the_same_bytes(self):
        for name, *options in (["x.png"], ["l.png", "--translucent", "--perspective", "--window", "0.2,0.6"],
                               ["c.png", "--cells", 70, "--plane", "100,0,0,1,0,0"],
                               ["p.png", "--preview"], ["q.png", "--translucent", "--preview", "--perspective"],
                               ["f.png", "--surface", "0.2,0.4,0.3"],
                               ["s.png", "--surface", 0.4, "--plane", "100,0,0,1,0,0", "--view", "0.3,-0.4,0.9"]):
            options += ["--size", 96]
            said = self.ask("render", "block", self.folder / name, *options)
            self.ask("render", "block", self.folder / f"again_{name}", *options, "--threads", 1)
            first = (self.folder / name).read_bytes()
            self.assertEqual(first, (self.folder / f"again_{name}").read_bytes())
            self.assertEqual(said["bytes"], len(first))
            width, height = struct.unpack(">II", first[16:24])
            self.assertTrue(first.startswith(b"\x89PNG") and width >= 96 and height >= 96)

    def test_the_scale_of_a_picture_is_the_blocks(self):
        """Seen along z the region fills 84 % of 88 % of the picture; the rest is for its axes."""
        said = self.ask("render", "block", self.folder / "z.png", "--view", "z", "--size", 100)
        self.near(said["um_per_px"], (HIGH - LOW) / 88 / 0.84, 1e-9)


class Refusals(Model):
    def complaint(self, code, *args):
        return self.refused(self.call(*[str(arg) for arg in args]), code)

    def test_a_point_outside_names_the_box(self):
        line = self.complaint(65, "probe", "block", 9999, 0, 0)
        self.assertIn("(9999, 0, 0) um lies outside the model, where there is no data", line)

    def test_what_is_not_there(self):
        self.assertIn("there is no specimen nobody",
                      self.complaint(66, "probe", "nobody", 1, 2, 3))
        self.assertIn("runs outside the model",
                      self.complaint(65, "line", "block", 900, 900, 900, 999, 999, 999))
        self.assertIn("holds no voxel of the region",
                      self.complaint(65, "integral", "block", "--box", "900,900,900,999,999,999"))
        self.assertIn("the plane misses the region",
                      self.complaint(65, "integral", "block", "--plane", "0,0,999,0,0,1"))
        self.assertIn("the density is 7 nowhere in the region",
                      self.complaint(65, "export", "block", self.folder / "a.stl", "--level", 7))

    def test_words_that_fit_nothing(self):
        out = self.folder / "model.obj"
        self.assertIn("the file's ending says what to write", self.complaint(64, "export", "block", out))
        for args in (["export", "block"], ["probe", "block", 1, 2], ["probe", "block", 1, 2, "x"],
                     ["line", "block", 1, 2, 3], ["line", "block", 1, 2, 3, 1, 2, 3],
                     ["line", "block", 0, 0, 0, 9, 9, 9, "--points", 1],
                     ["integral", "block", "--box", "1,2,3"],
                     ["integral", "block", "--plane", "1,2,3,4,5"],
                     ["integral", "block", "--whole", "--level", 0.5],
                     ["export", "block", self.folder / "a.stl"],
                     ["export", "block", self.folder / "a.csv", "--level", 0.3],
                     ["export", "block", self.folder / "a.vtu", "--step", 3],
                     ["export", "block", self.folder / "a.nrrd", "--step", -3],
                     ["render", "block"], ["render", "block", self.folder / "a.jpg"],
                     ["render", "block", self.folder / "a.png", "--view", "up"],
                     ["render", "block", self.folder / "a.png", "--size", 0],
                     ["render", "block", self.folder / "a.png", "--window", "0,1"],
                     ["render", "block", self.folder / "a.png", "--translucent", "--window", "1,0"],
                     ["render", "block", self.folder / "a.png", "--translucent", "--surface", 1],
                     ["render", "block", self.folder / "a.png", "--preview", "--surface", 1],
                     ["render", "block", self.folder / "a.png", "--surface", "0.3,0.3"],
                     ["render", "block", self.folder / "a.png", "--surface", "1,2,3,4,5"],
                     ["render", "block", self.folder / "a.png", "--cells", 0],
                     ["render", "block", self.folder / "a.png", "--cells", 101],
                     ["render", "block", self.folder / "a.png", "--cells", 70, "--translucent"],
                     ["render", "block", self.folder / "a.png", "--cells", 70, "--preview"],
                     ["render", "block", self.folder / "a.png", "--true-colour"],
                     ["render", "block", self.folder / "a.png", "--cells", 70, "--true-colour"],
                     ["render", "block", self.folder / "a.png", "--translucent", "--true-colour", "--preview"],
                     ["render"] + 9 * ["block"] + [self.folder / "a.png"],
                     ["render", "block", self.folder / "a.png", "--box", "1,2,3"]):
            self.complaint(64, *args)
        self.assertEqual(list(self.folder.iterdir()), [])

    def test_a_grid_that_is_too_large_is_refused_before_it_is_made(self):
        self.assertIn("a larger --step", self.complaint(65, "export", "block", self.folder / "a.nrrd",
                                                        "--step", 0.01))

    def test_a_picture_of_nothing_is_refused(self):
        out = self.folder / "a.png"
        self.assertIn("nothing of the region lies in the box",
                      self.complaint(65, "render", "block", out, "--box", "900,900,900,999,999,999"))
        self.assertIn("no cell of the window's densities",
                      self.complaint(65, "render", "block", out, "--cells", 50, "--window", "7,8"))
        self.assertIn("has no normal", self.complaint(65, "render", "block", out, "--plane", "0,0,0,0,0,0"))
        self.assertIn("no direction", self.complaint(65, "render", "block", out, "--view", "0,0,0"))
        self.assertFalse(out.exists())

    def test_a_file_that_exists_stays(self):
        there = self.folder / "there.csv"
        there.write_text("mine")
        self.assertIn("exists already", self.complaint(64, "export", "block", there))
        self.assertEqual(there.read_text(), "mine")
        picture = self.folder / "there.png"
        picture.write_text("mine")
        self.assertIn("exists already", self.complaint(64, "render", "block", picture))
        self.assertEqual(picture.read_text(), "mine")

    def test_a_volume_has_no_stack_in_colour(self):
        self.assertIn("has no stack of sections in colour",
                      self.complaint(66, "export", "block", self.folder / "a.ome.tif"))
        self.assertIn("has no colours: a volume has none",
                      self.complaint(66, "render", "block", self.folder / "a.png", "--surface", 0.3,
                                     "--true-colour"))

    def test_a_specimen_without_a_report(self):
        self.store = self.folder / "store"
        write_volume(self.folder / "v.nrrd")
        self.assertEqual(self.call("import", "--volume", str(self.folder / "v.nrrd"), "--specimen",
                                   "young").returncode, 0)
        self.assertIn("young has no report yet: `gieson run` does the jobs",
                      self.complaint(66, "probe", "young", 1, 2, 3))

    @contextlib.contextmanager
    def changed(self, pattern, at):
        """One byte of a file of a copy of the store is another."""
        shutil.copytree(self.store, self.folder / "copy")
        self.store = self.folder / "copy"
        path = next(self.store.glob(pattern))
        data = bytearray(path.read_bytes())
        data[at] ^= 1
        path.write_bytes(data)
        yield path

    def test_a_model_that_was_changed_is_not_used(self):
        with self.changed("reports/block/[0-9a-f]*/model.vtkhdf", 5000):
            for args in (["probe", "block", 1, 2, 3], ["line", "block", 0, 0, 0, 9, 9, 9],
                         ["integral", "block"], ["export", "block", self.folder / "a.vtkhdf"]):
                line = self.complaint(65, *args)
                self.assertIn("model.vtkhdf", line)
                self.assertIn("it is not used. `gieson verify 1` says what else changed", line)

    def test_a_report_that_was_changed_vouches_for_nothing(self):
        with self.changed("reports/block/[0-9a-f]*/report.json", 100):
            self.assertIn("it is not used", self.complaint(65, "probe", "block", 1, 2, 3))

    def test_a_model_that_is_gone(self):
        shutil.copytree(self.store, self.folder / "copy")
        self.store = self.folder / "copy"
        next(self.store.glob("reports/block/[0-9a-f]*/model.vtkhdf")).unlink()
        self.assertIn("it is not used", self.complaint(66, "probe", "block", 1, 2, 3))


class Readers(Model):
    def evaluate(self, grid, points):
        """The values at points as vtkProbeFilter finds them."""
        where = vtk.vtkPoints()
        where.SetDataTypeToDouble()
        for point in points:
            where.InsertNextPoint(point)
        cloud = vtk.vtkPolyData()
        cloud.SetPoints(where)
        probe = vtk.vtkProbeFilter()
        probe.SetFindCellStrategy(vtk.vtkCellLocatorStrategy())
        probe.SetInputData(cloud)
        probe.SetSourceData(grid)
        probe.Update()
        return vtk_to_numpy(probe.GetOutput().GetPointData().GetArray("s"))

    def read(self, reader, path):
        reader.SetFileName(str(path))
        reader.Update()
        return reader.GetOutput()

    def pixels(self, path):
        picture = self.read(vtk.vtkPNGReader(), path)
        wide, high, _ = picture.GetDimensions()
        return vtk_to_numpy(picture.GetPointData().GetScalars()).reshape(high, wide, -1)[::-1].astype(int)

    def test_pictures_side_by_side_have_one_scale(self):
        """The half as long one has a quarter of the pixels, and both the colours of one window."""
        for what in (["--cells", 100], ["--surface", 0.1], []):
            options = [*what, "--view", "z", "--size", 250]
            alone, both = (self.folder / f"{n}{len(options)}{options[0][2:]}.png" for n in "ab")
            said = [self.ask("render", *names, path, *options)
                    for names, path in ((["block"], alone), (["half", "block"], both))]
            self.assertEqual(said[1]["beside"], [{"specimen": "block", "run": said[0]["run"]}])
            self.assertEqual(said[0]["um_per_px"], said[1]["um_per_px"])
            one, two = self.pixels(alone), self.pixels(both)
            half = two.shape[1] - one.shape[1]
            self.assertTrue((two[:, half:] == one).all())
            if what[:1] != ["--surface"]:  # cells reach beyond; half as deep an X-ray is as dark
                continue
            # What has a colour at all, left of the colour scale, and is no axis: the region.
            coloured = [numpy.ptp(p[:, :250], axis=2) > 60 for p in (two, one)]
            counts = [c[:, 12:].sum() for c in coloured]
            self.assertLess(abs(counts[0] / counts[1] - 0.25), 0.06)

    def test_vtk_has_the_values_of_probe(self):
        points = [(20 + 9.1 * i, 200 - 7.3 * i, 31 + 5.7 * i) for i in range(20)]
        ours = [self.ask("probe", "block", *point)["value"] for point in points]
        for name, reader in (("a.vtkhdf", vtk.vtkHDFReader()),
                             ("a.vtu", vtk.vtkXMLUnstructuredGridReader())):
            grid = self.read(reader, self.export(name)[0])
            self.assertEqual(grid.GetCell(0).GetCellType(), vtk.VTK_BEZIER_TETRAHEDRON)
            theirs = self.evaluate(grid, points)
            # In the thin layer around a cell's faces (0.3 % of its size) s is not the cell's
            # polynomial; everywhere else both are equal to rounding.
            worst = sorted(abs(a - b) for a, b in zip(ours, theirs))
            self.assertLess(worst[15], 1e-12)
            self.assertLess(worst[-1], 1e-4)
            cells = grid.GetCellData()
            self.assertEqual(vtk_to_numpy(cells.GetArray("samples")).sum(), SIDE ** 3)

    def test_vtk_reads_surfaces_that_lie_at_the_level(self):
        sets = {}
        for name, reader in (("a.stl", vtk.vtkSTLReader()), ("a.ply", vtk.vtkPLYReader())):
            path, said = self.export(name, "--level", 0.35)
            surface = self.read(reader, path)
            self.assertIn(f"{surface.GetNumberOfCells()} triangles", said["holds"])
            points = vtk_to_numpy(surface.GetPoints().GetData())
            # At the level, or on the border of the region, which is a cube.
            off = CONSTANT + points @ numpy.array(SLOPE) - 0.35
            from_border = numpy.minimum(points - LOW, HIGH - points).min(axis=1)
            inside = from_border > 10  # beside edges and corners of the cube the border is round
            self.assertLess(abs(off[inside]).max(), BORDER)
            self.assertGreater(off.min(), -BORDER)
            self.assertGreater(from_border.min(), -5)
            self.assertGreater(inside.sum(), 100)
            sets[name] = surface.GetNumberOfCells()
            mass = vtk.vtkMassProperties()
            mass.SetInputData(surface)
            words = said["holds"].split()
            area = 1e6 * (float(words[words.index("mm2,") - 1]) + float(words[words.index("by") + 1]))
            self.near(mass.GetSurfaceArea(), area, 1e-3 * mass.GetSurfaceArea())
            share = sum(1 for i in range(60 ** 3) if field(
                *[LOW + (k + 0.5) * (HIGH - LOW) / 60 for k in (i % 60, i // 60 % 60, i // 3600)])
                > 0.35) / 60 ** 3
            self.near(mass.GetVolume() / (HIGH - LOW) ** 3, share, 0.02)
        self.assertEqual(sets["a.stl"], sets["a.ply"])

    def check_closed(self, surface):
        """Every edge has two triangles, and none is without area, as VTK counts them."""
        edges = vtk.vtkFeatureEdges()
        edges.SetInputData(surface)
        edges.FeatureEdgesOff()
        edges.BoundaryEdgesOn()
        edges.NonManifoldEdgesOn()
        edges.ManifoldEdgesOff()
        edges.Update()
        self.assertEqual(edges.GetOutput().GetNumberOfCells(), 0)
        quality = vtk.vtkMeshQuality()
        quality.SetInputData(surface)
        quality.SetTriangleQualityMeasureToArea()
        quality.Update()
        self.assertGreater(vtk_to_numpy(quality.GetOutput().GetCellData().GetArray("Quality")).min(),
                           0)

    def test_surfaces_are_closed_manifolds_where_the_region_ends(self):
        for level in (0.2, 0.35, 0.5, 0.65):
            self.check_closed(self.read(vtk.vtkPLYReader(),
                                        self.export(f"{level}.ply", "--level", level)[0]))

    def test_vtk_reads_the_gltf_as_the_same_surface_in_metres(self):
        ply = self.read(vtk.vtkPLYReader(), self.export("a.ply", "--level", 0.35)[0])
        reader = vtk.vtkGLTFReader()
        reader.SetFileName(str(self.export("a.glb", "--level", 0.35)[0]))
        reader.ApplyDeformationsToGeometryOn()
        reader.Update()
        blocks = reader.GetOutput().NewIterator()
        blocks.InitTraversal()
        surface = blocks.GetCurrentDataObject()
        self.assertEqual(surface.GetNumberOfCells(), ply.GetNumberOfCells())
        ours = vtk_to_numpy(ply.GetPoints().GetData())
        theirs = 1e6 * vtk_to_numpy(surface.GetPoints().GetData())
        self.assertLess(abs(ours - theirs).max(), 1e-3)
        normals = [vtk_to_numpy(s.GetPointData().GetNormals()) for s in (ply, surface)]
        self.assertLess(abs(normals[0] - normals[1]).max(), 1e-5)

    def test_normals_of_a_ply_point_to_smaller_values(self):
        surface = self.read(vtk.vtkPLYReader(), self.export("a.ply", "--level", 0.35)[0])
        points = vtk_to_numpy(surface.GetPoints().GetData()).astype(float)
        inside = numpy.minimum(points - LOW, HIGH - points).min(axis=1) > 10
        normals = vtk_to_numpy(surface.GetPointData().GetNormals())
        down = -numpy.array(SLOPE) / numpy.linalg.norm(SLOPE)
        self.assertGreater((normals[inside] @ down).min(), 0.99)
        corners = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        own = points[corners[inside[corners].all(axis=1)]]
        faces = numpy.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
        self.assertGreater(len(faces), 100)
        self.assertGreaterEqual((faces @ down).min(), -1e-6)

    def test_numpy_reads_the_nrrd(self):
        path, _ = self.export("a.nrrd", "--step", 7)
        head, body = path.read_bytes().split(b"\n\n", 1)
        fields = dict(line.split(": ", 1) for line in head.decode().splitlines()[2:])
        self.assertEqual((fields["type"], fields["endian"], fields["encoding"]),
                         ("float", "little", "raw"))
        sizes = [int(word) for word in fields["sizes"].split()]
        origin = [float(word) for word in fields["space origin"].strip("()").split(",")]
        self.assert_volume(numpy.frombuffer(body, "<f4").reshape(sizes[::-1]), origin, 7)

    def test_numpy_reads_the_nifti(self):
        for name in ("a.nii", "a.nii.gz"):
            path, _ = self.export(name)
            data = path.read_bytes()
            data = gzip.decompress(data) if name.endswith("gz") else data
            self.assertEqual(struct.unpack_from("<i", data)[0], 348)
            self.assertEqual(data[344:348], b"n+1\0")
            self.assertEqual(struct.unpack_from("<8h", data, 40), (3, SIDE, SIDE, SIDE, 1, 1, 1, 1))
            self.assertEqual(struct.unpack_from("<2h", data, 70), (16, 32))
            self.assertEqual(data[123], 3)  # micrometres
            rows = numpy.frombuffer(data, "<f4", 12, 280).reshape(3, 4)
            self.assertTrue((rows[:, :3] == numpy.diag([STEP] * 3)).all())
            start = int(struct.unpack_from("<f", data, 108)[0])
            self.assert_volume(numpy.frombuffer(data, "<f4", offset=start).reshape([SIDE] * 3),
                               rows[:, 3], STEP)

    def test_vtk_reads_the_nifti_where_it_lies(self):
        reader = vtk.vtkNIFTIImageReader()
        image = self.read(reader, self.export("a.nii.gz")[0])
        self.assertEqual(image.GetDimensions(), (SIDE,) * 3)
        self.assertEqual(image.GetSpacing(), (STEP,) * 3)

    def assert_volume(self, voxels, origin, step):
        z, y, x = numpy.indices(voxels.shape) * step
        truth = field(x + origin[0], y + origin[1], z + origin[2])
        self.assertLess(numpy.nanmax(abs(voxels - truth)), BORDER)
        inner = (slice(6, -6),) * 3
        self.assertLess(abs(voxels - truth)[inner].max(), FIT)
        self.assertLess(numpy.isnan(voxels).mean(), 0.2)


def main():
    bench.BIN = pathlib.Path(sys.argv[1]).resolve()
    topics = sys.argv[2:]
    if "Readers" in topics and MISSING:
        print(f"SKIPPED: {MISSING[0]}: nobody read the exported files", file=sys.stderr)
        sys.exit(bench.SKIPPED)
    unittest.main(argv=[sys.argv[0], *topics], verbosity=1)


if __name__ == "__main__":
    main()
