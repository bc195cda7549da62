#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The VTK side of gieson-bench: vtkProbeFilter from linear tetrahedra onto a grid, one thread.

    vtk_probe.py MESH.vtk EDGE VALUES

The grid has EDGE^3 points, the centres of as many voxels that fill the unit cube. Orders come one
a line on stdin; each is answered with a line, seconds of CPU time (0 where nothing is timed):
    load     reads the mesh
    probe    a fresh filter's Update(), nothing else in the time
    write    the last values to the file VALUES, as doubles in the order of the grid
Ends at the end of stdin; exits at once when VTK is not there.
"""
import os
import sys
import time

os.environ["VTK_SMP_MAX_THREADS"] = "1"
import vtk  # noqa: E402


def load(path):
    reader = vtk.vtkUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    mesh = reader.GetOutput()
    assert mesh.GetNumberOfCells() > 0
    return mesh


def voxel_centres(edge):
    grid = vtk.vtkImageData()
    grid.SetDimensions(edge, edge, edge)
    grid.SetOrigin(0.5 / edge, 0.5 / edge, 0.5 / edge)
    grid.SetSpacing(1 / edge, 1 / edge, 1 / edge)
    return grid


def probe(mesh, grid):
    """The filter's output and the CPU seconds of all threads of its Update()."""
    fresh_mesh, fresh_grid = mesh.NewInstance(), grid.NewInstance()
    fresh_mesh.DeepCopy(mesh)  # nothing remembered from the last turn
    fresh_grid.DeepCopy(grid)
    one = vtk.vtkProbeFilter()
    one.SetInputData(fresh_grid)
    one.SetSourceData(fresh_mesh)
    before = time.process_time()
    one.Update()
    return one.GetOutput(), time.process_time() - before


def main():
    mesh_path, edge, values_path = sys.argv[1:4]
    vtk.vtkSMPTools.Initialize(1)
    mesh = output = None
    grid = voxel_centres(int(edge))
    for order in sys.stdin:
        seconds = 0.0
        if order.strip() == "load":
            mesh = load(mesh_path)
        elif order.strip() == "probe":
            output, seconds = probe(mesh, grid)
        elif order.strip() == "write":
            with open(values_path, "wb") as file:
                file.write(memoryview(output.GetPointData().GetArray("s")))
        print(repr(seconds), flush=True)


if __name__ == "__main__":
    main()
