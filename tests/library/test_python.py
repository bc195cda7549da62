#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The Python module against closed forms in numpy.

    test_python.py LIBRARY FOLDER MESHER"""
import gc
import itertools
import os
import pathlib
import sys
import tempfile

try:
    import numpy as np
except ImportError:
    print("skipped: Debian's Python has no numpy")
    sys.exit(77)

os.environ["GIESON_SPLINE_LIBRARY"] = sys.argv[1]
sys.path.insert(0, sys.argv[2])
sys.dont_write_bytecode = True
import gieson_spline as gs  # noqa: E402

MESHER = sys.argv[3]
EXACT = {"smoothing": 0, "tolerance": 1e-13}
rng = np.random.default_rng(26)


def cube(n):
    """The unit cube, n cells along each edge, six tetrahedra a cell."""
    side = n + 1
    z, y, x = np.meshgrid(*[np.arange(side) / n] * 3, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    step = np.array([1, side, side * side])
    tets = []
    for cell in itertools.product(range(n), repeat=3):
        first = int(np.dot(cell, step))
        for way in itertools.permutations(range(3)):
            tets.append(first + np.concatenate([[0], np.cumsum(step[list(way)])]))
    return points, np.array(tets)


def cubic(u):
    x, y, z = np.asarray(u).T
    return 1 + x - 2 * y * z + 3 * x * x * y - z**3


def cubic_gradient(u):
    x, y, z = np.asarray(u).T
    return np.stack([1 + 6 * x * y, -2 * z + 3 * x * x, -2 * y - 3 * z * z], axis=1)


def refused(code, sentence, function, *arguments, **named):
    try:
        function(*arguments, **named)
    except gs.Error as error:
        assert error.code == code and sentence in str(error), (error.code, str(error))
        return
    raise AssertionError(f"not refused: {sentence}")


def test_space():
    points, tets = cube(2)
    space = gs.Space(points, tets, degree=3)
    assert np.array_equal(space.points, points) and len(space.tetrahedra) == len(tets)
    corners = points[space.tetrahedra.astype(int)]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0).all()
    assert np.array_equal(space.knots[:, 0], points) and space.knots.shape == (27, 4, 3)
    # The same knots given back make the same space.
    again = gs.Space(space.points, space.tetrahedra, degree=3, knots=space.knots)
    assert np.array_equal(again.knots, space.knots) and again.unknowns == space.unknowns == 343
    refused("mesh", "too thin", gs.Space, points, tets, cloud=1e-12)
    refused("mesh", "", gs.Space, points, [[0, 1, 2, 99]])
    refused("input", "degree 4", gs.Space, points, tets, degree=4)


def test_fit_and_values():
    space = gs.Space(*cube(3), degree=3)
    at, probe = rng.random((20000, 3)), rng.random((4000, 3))
    field, report = space.fit(at, cubic(at), **EXACT)
    assert report.samples == 20000 and report.rms < 1e-9 and not report.unconverged, report
    assert np.abs(field(probe) - cubic(probe)).max() < 1e-8
    assert np.abs(field.gradient(probe) - cubic_gradient(probe)).max() < 1e-7
    x, y, z = probe.T
    zero = 0 * x
    hessian = np.stack([6 * y, 6 * x, zero, 6 * x, zero, zero - 2, zero, zero - 2, -6 * z], axis=1)
    assert np.abs(field.hessian(probe) - hessian.reshape(-1, 3, 3)).max() < 1e-4
    assert abs(field((0.2, 0.3, 0.4)) - cubic([[0.2, 0.3, 0.4]])[0]) < 1e-8
    assert np.isnan(field((2, 0, 0)))
    grid = field.on_grid((4, 5, 6), step=(0.1, 0.15, 0.2), origin=(0.1, 0.2, 0.15))
    zz, yy, xx = np.meshgrid(0.15 + 0.2 * np.arange(4), 0.2 + 0.15 * np.arange(5),
                             0.1 + 0.1 * np.arange(6), indexing="ij")
    places = np.stack([xx, yy, zz], axis=-1).reshape(-1, 3)
    assert np.abs(grid.ravel() - cubic(places)).max() < 1e-8
    one, _ = space.fit(at, cubic(at), threads=1, **EXACT)
    assert np.array_equal(one.controls, field.controls)
    assert np.array_equal(space.field(field.controls)(probe), field(probe))


def test_weights_and_reports():
    space = gs.Space(*cube(2), degree=2)
    at = rng.random((8000, 3))
    plane = at @ [2.0, -1.0, 5.0]
    bad = np.arange(len(at)) % 10 == 0
    field, _ = space.fit(at, plane + 1000 * bad, weights=1.0 - bad, **EXACT)
    probe = rng.random((500, 3))
    assert np.abs(field(probe) - probe @ [2.0, -1.0, 5.0]).max() < 1e-8
    outside = at.copy()
    outside[[5, 77], 1] = 9
    _, report = space.fit(outside, plane)
    assert (report.outside, report.first_outside, report.samples) == (2, 5, 7998), report
    refused("input", "sample 5", space.fit, outside, plane, strict=True)
    _, report = space.fit(at, np.sin(9 * plane), iterations=2)
    assert report.unconverged == 1
    refused("fit", "2 iterations", space.fit, at, np.sin(9 * plane), iterations=2, strict=True)
    said = []
    space.fit(at, plane, progress=lambda *told: said.append(told))
    assert said[-1] == ("fit", 4, 4), said
    wave = np.sin(3 * at[:, 0])
    noisy = wave + rng.normal(0, 0.3, len(at))
    fine = gs.Space(*cube(3), degree=3)
    rough, _ = fine.fit(at, noisy)
    smooth, report = fine.fit(at, noisy, folds=np.arange(len(at)) % 2)
    assert report.jump > 0 and 0.28 < report.predicted < 0.33, report
    assert np.std(smooth(at) - wave) < 0.6 * np.std(rough(at) - wave)
    for wrong in ({"weights": [1, 2]}, {"folds": [0]}):
        try:
            space.fit(at, plane, **wrong)
        except ValueError:
            continue
        raise AssertionError(wrong)


def test_free_knots():
    """Against numpy's own residuals, on a wall aslant through tetrahedra of a third of the cube."""
    space = gs.Space(*cube(3), degree=2)
    at = rng.random((6000, 3))
    wall = np.tanh((at @ [1.0, 0.4, -0.3] - 0.57) / 0.06)
    fixed, _ = space.fit(at, wall)
    field, report, free = space.fit_free(at, wall, steps=8)
    rms = np.sqrt(np.mean((field(at) - wall)**2)), np.sqrt(np.mean((fixed(at) - wall)**2))
    assert abs(report.rms - rms[0]) < 1e-9 and abs(free.rms_fixed - rms[1]) < 1e-9, (free, rms)
    assert rms[0] < 0.8 * rms[1] and free.vertex_steps > 0, (free, rms)
    assert field.space.unknowns == space.unknowns
    moved = np.abs(field.space.points - space.points).max(axis=1) > 0
    assert moved.any() and not moved[((space.points == 0) | (space.points == 1)).any(axis=1)].any()
    refused("input", "sample 0", space.fit_free, at + 9, wall, strict=True)


def test_inserted_vertices():
    """Values everywhere as before, of a field that no polynomial is; and it can be fitted on."""
    for degree in (1, 2, 3):
        space = gs.Space(*cube(2), degree=degree)
        field = space.field(rng.random(space.unknowns))
        tets = space.points[space.tetrahedra].mean(axis=1)
        vertex = tets[5] + 0.02 * rng.random(3)
        more = field.insert(vertex + np.vstack([np.zeros(3), 1e-3 * (rng.random((degree, 3)) - 0.5)]))
        assert len(more.space.points) == len(space.points) + 1 and len(more.space.tetrahedra) == len(tets) + 3
        assert np.array_equal(more.space.points[-1], vertex)
        probe = np.vstack([rng.random((500, 3)), vertex + 1e-3 * (rng.random((500, 3)) - 0.5)])
        assert np.abs(more(probe) - field(probe)).max() < 1e-12
        again = more.insert(np.tile(more.space.points[more.space.tetrahedra].mean(axis=1)[-1], (degree + 1, 1))
                            + 1e-4 * rng.random((degree + 1, 3)))
        assert np.abs(again(probe) - field(probe)).max() < 1e-12
        refused("input", "does not lie in the mesh", field.insert, np.full((degree + 1, 3), 7.0))
        refused("mesh", "inside tetrahedron", field.insert, np.tile(space.points[0], (degree + 1, 1)))
        try:
            field.insert(vertex[None].repeat(degree + 2, axis=0))
        except ValueError:
            continue
        raise AssertionError("one knot too many was taken")


def test_channels():
    space = gs.Space(*cube(2), degree=3)
    at = rng.random((9000, 3))
    powers = np.stack([at[:, 0]**c for c in range(4)])
    fields, reports = space.fit(at, powers, **EXACT)
    assert len(fields) == len(reports) == 4
    for c, field in enumerate(fields):
        assert abs(field((0.3, 0.7, 0.2)) - 0.3**c) < 1e-8
    alone, _ = space.fit(at, powers[2], **EXACT)
    assert np.array_equal(alone.controls, fields[2].controls)


def test_integrals():
    space = gs.Space(*cube(2), degree=3)
    at = rng.random((9000, 3))
    field, _ = space.fit(at, cubic(at), **EXACT)
    a, b = np.array([0.1, 0.2, 0.9]), np.array([0.8, 0.6, 0.1])
    nodes, weights = np.polynomial.legendre.leggauss(4)
    along = cubic(a + np.outer((nodes + 1) / 2, b - a)) @ weights / 2 * np.linalg.norm(b - a)
    integral, length = field.segment(a, b)
    assert abs(integral - along) < 1e-9 and abs(length - np.linalg.norm(b - a)) < 1e-12
    integral, volume = field.integral()
    truth = 1 + 1 / 2 - 1 / 2 + 3 / 3 / 2 - 1 / 4
    assert abs(volume - 1) < 1e-12 and abs(integral - truth) < 1e-9
    assert abs(field.means().mean() - truth) < 1e-9
    thin, _ = gs.Space(*cube(2), degree=3, cloud=1e-4).fit(at, cubic(at), **EXACT)
    assert abs(thin.line((-3, 0.3, 0.6), (5, 0, 0)) - (1.5 - 0.36 + 0.3 - 0.216)) < 1e-3


def test_volumes():
    space = gs.Space(*cube(2), degree=2)
    at = rng.random((9000, 3))
    field, _ = space.fit(at, at[:, 0], **EXACT)
    mask = np.ones((10, 10, 10))
    mask[:, 5:, :] = 0
    low, high = field.volume_above([0.3, 0.55], mask, step=0.08, origin=0.14)
    for bound, truth in ((low, 0.6 * 0.4 * 0.8), (high, 0.35 * 0.4 * 0.8)):
        assert bound.lower - 1e-9 <= truth <= bound.upper + 1e-9, (bound, truth)
        assert bound.upper - bound.lower < 1e-3 * bound.upper
    assert field.volume_above(2.0, mask, step=0.08, origin=0.14).upper == 0
    refused("input", "", field.volume_above, 0.5, mask, step=1)


def test_cover():
    z, y, x = np.mgrid[:20, :20, :20] - 9.5
    mask = x * x + y * y + z * z < 49
    space = gs.Space.cover(mask, step=2, edge=12, mesher=MESHER)
    grid = space.field(np.full(space.unknowns, 7.0)).on_grid(mask.shape, step=2)
    assert np.abs(grid[mask] - 7).max() < 1e-12
    refused("input", "", gs.Space.cover, 0 * mask, step=2, edge=12, mesher=MESHER)


def test_follow():
    """A ball with a wall a voxel wide, in a unit of its own: on a mesh that follows the wall the field is
    three times nearer to it with a quarter of the unknowns."""
    step = 0.05
    z, y, x = (np.mgrid[:32, :32, :32] - 15.5) * step
    far = np.sqrt(x * x + y * y + z * z)
    ball = 0.5 - 0.5 * np.tanh((far - 0.5) / step)
    mask = far < 0.7
    at = np.stack([x[mask], y[mask], z[mask]], axis=1)
    where = dict(step=step, origin=-15.5 * step, degree=2, mesher=MESHER)
    follows = gs.Space.follow(ball, edge=0.22, mask=mask, **where)
    covers = gs.Space.cover(mask, edge=0.25, **where)
    assert follows.unknowns < covers.unknowns / 4, (follows.unknowns, covers.unknowns)
    off = [space.fit(at, ball[mask])[1].rms for space in (follows, covers)]
    print(f"unknowns {follows.unknowns} and {covers.unknowns}, rms {off[0]:.4f} and {off[1]:.4f}")
    assert off[0] < off[1] / 3, off
    refused("input", "", gs.Space.follow, np.full((8, 8, 8), np.nan), edge=0.3, **where)
    refused("input", "an edge of", gs.Space.follow, ball, edge=0, mask=mask, **where)
    try:
        gs.Space.follow(ball, edge=0.3, mask=mask[1:], **where)
        raise AssertionError("a mask of another shape was taken")
    except ValueError:
        pass


def test_files():
    space = gs.Space(*cube(2), degree=3)
    at = rng.random((9000, 3))
    field, _ = space.fit(at, np.sum((at - 0.5)**2, axis=1))
    with tempfile.TemporaryDirectory() as there:
        folder = pathlib.Path(there)
        field.save(folder / "a.vtkhdf", name="a ball")
        again = gs.load(folder / "a.vtkhdf")
        inner = again.space
        assert np.array_equal(again.controls, field.controls)
        del again
        gc.collect()
        assert np.array_equal(inner.knots, space.knots)  # a space keeps the field that owns it
        field.write_cells(folder / "a.csv")
        table = np.genfromtxt(folder / "a.csv", delimiter=",", names=True)
        assert np.abs(table["density"] - field.means()).max() < 1e-6
        assert abs(table["volume_um3"].sum() - 1) < 1e-6
        field.write_cells(folder / "a.vtu")
        field.write_surface(folder / "a.stl", level=0.09)
        raw = np.fromfile(folder / "a.stl", dtype=np.uint8)[84:].reshape(-1, 50)
        corners = np.ascontiguousarray(raw[:, 12:48]).view("<f4").reshape(-1, 3)
        assert np.abs(np.linalg.norm(corners - 0.5, axis=1) - 0.3).max() < 1e-3
        field.write_grid(folder / "a.nrrd", (4, 5, 6), step=0.1, origin=0.2)
        data = (folder / "a.nrrd").read_bytes().split(b"\n\n", 1)[1]
        grid = field.on_grid((4, 5, 6), step=0.1, origin=0.2)
        assert np.array_equal(np.frombuffer(data, "<f4"), grid.ravel().astype("<f4"))
        refused("unsupported", ".stl or .ply", field.write_surface, folder / "a.obj", level=0.09)
        refused("notfound", "", gs.load, folder / "b.vtkhdf")
        refused("input", "", gs.load, folder / "a.csv")


def test_everything_has_a_docstring():
    for thing in (gs, gs.Error, gs.Report, gs.Volume, gs.load, *vars(gs.Space).values(),
                  *vars(gs.Field).values()):
        name = getattr(thing, "__name__", "_")
        if callable(thing) and not name.startswith("_") or isinstance(thing, property):
            assert thing.__doc__, thing


for title, test in [(k, v) for k, v in globals().items() if k.startswith("test_")]:
    test()
    print(title.replace("_", " "))
