#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""VTK reads the files test_model_file.c left in a folder and evaluates them as the spline itself does.

    test_model_file.py FOLDER      exit 77 (skipped) when python3-vtk9 is not installed

NAME.txt has lines "tet x y z s" by gsn_spline_eval(). Each point is asked of the cell alone
(EvaluatePosition, then the cell's own interpolation) and of the whole grid (vtkProbeFilter), which
also has to find the cell.
"""
import pathlib
import sys

try:
    import vtk
except ImportError:
    print("SKIPPED: python3-vtk9 is not installed, nobody checked the model files", file=sys.stderr)
    sys.exit(77)

TOLERANCE = 1e-12
# VTK's cells claim points up to 1e-3 beyond their faces (barycentric), so that in the skin its
# search may answer with the neighbour's polynomial, which is another one.
SKIN = 0.01
DEGREES = {"n1": 4, "n2": 10, "n3": 20}  # name's end -> points a cell
NAMES = [f"{kind}_n{n}" for kind in ("collapsed_shared", "collapsed_own", "polynomial")
         for n in (1, 2, 3)]


def read(path):
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def at_cell(grid, tet, x):
    """The value of cell tet at x, by nothing but the cell, and whether x lies well inside it."""
    cell = grid.GetCell(tet)
    values = grid.GetPointData().GetArray("s")
    points = cell.GetNumberOfPoints()
    closest, inside, weights = [0.0] * 3, [0.0] * 3, [0.0] * points
    sub, distance2 = vtk.reference(0), vtk.reference(0.0)
    assert cell.EvaluatePosition(x, closest, sub, inside, distance2, weights) == 1, \
        f"cell {tet} does not hold {x}"
    cell.InterpolateFunctions(inside, weights)
    return (sum(weights[i] * values.GetValue(cell.GetPointId(i)) for i in range(points)),
            min(*inside, 1 - sum(inside)) > SKIN)


def at_grid(grid, points):
    """The values at all points as vtkProbeFilter finds them."""
    where = vtk.vtkPoints()
    where.SetDataTypeToDouble()
    for x in points:
        where.InsertNextPoint(x)
    cloud = vtk.vtkPolyData()
    cloud.SetPoints(where)
    probe = vtk.vtkProbeFilter()
    # The default strategy walks over shared points, and these cells share none.
    probe.SetFindCellStrategy(vtk.vtkCellLocatorStrategy())
    probe.SetInputData(cloud)
    probe.SetSourceData(grid)
    probe.Update()
    output = probe.GetOutput().GetPointData()
    found = output.GetArray("vtkValidPointMask")
    assert all(found.GetValue(i) for i in range(len(points))), "vtkProbeFilter lost points"
    return [output.GetArray("s").GetValue(i) for i in range(len(points))]


def check(folder, name):
    grid = read(folder / (name + ".vtkhdf"))
    rows = [line.split() for line in (folder / (name + ".txt")).read_text().splitlines()]
    assert rows and grid.GetNumberOfCells() > 0, f"{name}: nothing to compare"
    for tet in range(grid.GetNumberOfCells()):
        cell = grid.GetCell(tet)
        assert cell.GetCellType() == vtk.VTK_BEZIER_TETRAHEDRON
        assert cell.GetNumberOfPoints() == DEGREES[name[-2:]]
    points = [[float(v) for v in row[1:4]] for row in rows]
    truth = [float(row[4]) for row in rows]
    ours = [at_cell(grid, int(row[0]), x) for row, x in zip(rows, points)]
    deep = [i for i, (_, well_inside) in enumerate(ours) if well_inside]
    assert 2 * len(deep) > len(rows), f"{name}: hardly a point lies well inside a cell"
    found = at_grid(grid, [points[i] for i in deep])
    # The rounding of each is relative to the largest value there is.
    scale = max(1.0, max(abs(v) for v in truth))
    worst_cell = max(abs(a - b) for (a, _), b in zip(ours, truth)) / scale
    worst_grid = max(abs(a - truth[i]) for a, i in zip(found, deep)) / scale
    print(f"{name}: largest difference {worst_cell:.2g} by cell at {len(rows)} points, "
          f"{worst_grid:.2g} by vtkProbeFilter at {len(deep)}")
    return max(worst_cell, worst_grid) <= TOLERANCE


def main():
    folder = pathlib.Path(sys.argv[1])
    results = [check(folder, name) for name in NAMES]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
