#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The VTK side of gieson-bench rays: mappers on linear tetrahedra, orthographic, off screen, one thread.

    vtk_rays.py MESH.vtk CAMERA.json PICTURE

Absorption only: white emission, so that a pixel is 1 - exp(-kappa times the line integral). Orders
come one a line on stdin; each is answered with a line, seconds of CPU time, or "no REASON":
    load        reads the mesh
    raycast     vtkUnstructuredGridVolumeRayCastMapper
    projected   vtkProjectedTetrahedraMapper
    fixed       vtkFixedPointVolumeRayCastMapper, on 256^3 voxels of the mesh, step half a voxel
    write       the last picture's red channel to PICTURE, as bytes from the upper left
The first frame of a mapper is not in the time: it builds what later frames use.
"""
import json
import os
import sys
import time

os.environ["VTK_SMP_MAX_THREADS"] = "1"
os.environ.setdefault("LP_NUM_THREADS", "0")
import vtk  # noqa: E402
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402

EDGE = 256


class Scene:
    def __init__(self, path, camera):
        vtk.vtkMultiThreader.SetGlobalMaximumNumberOfThreads(1)
        reader = vtk.vtkUnstructuredGridReader()
        reader.SetFileName(path)
        reader.Update()
        self.mesh, self.camera = reader.GetOutput(), camera
        self.windows, self.last = {}, None

    def property(self, linear):
        """Opacity in proportion to the density; linear: as the mappers of tetrahedra take it."""
        # More than 1 a unit is clamped by the projecting mapper.
        unit, kappa = 0.8 / self.camera["kappa"], self.camera["kappa"]
        made, colour, opacity = vtk.vtkVolumeProperty(), vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        colour.AddRGBPoint(0, 1, 1, 1)
        colour.AddRGBPoint(1, 1, 1, 1)
        for i in range(2 if linear else 513):
            s = i / (1 if linear else 512)
            opacity.AddPoint(s, kappa * s * unit if linear else 1 - 2.718281828459045 ** (-kappa * s * unit))
        made.SetColor(colour)
        made.SetScalarOpacity(opacity)
        made.SetScalarOpacityUnitDistance(unit)
        made.SetInterpolationTypeToLinear()
        made.ShadeOff()
        return made

    def voxels(self):
        grid = vtk.vtkImageData()
        grid.SetDimensions(EDGE, EDGE, EDGE)
        grid.SetSpacing(1 / (EDGE - 1), 1 / (EDGE - 1), 1 / (EDGE - 1))
        probe = vtk.vtkProbeFilter()
        probe.SetInputData(grid)
        probe.SetSourceData(self.mesh)
        probe.Update()
        return probe.GetOutput()

    def mapper(self, name):
        if name == "projected":
            made = vtk.vtkProjectedTetrahedraMapper()
        elif name == "raycast":
            made = vtk.vtkUnstructuredGridVolumeRayCastMapper()
            made.AutoAdjustSampleDistancesOff()
            made.SetImageSampleDistance(1)
            made.SetNumberOfThreads(1)
        else:
            made = vtk.vtkFixedPointVolumeRayCastMapper()
            made.AutoAdjustSampleDistancesOff()
            made.SetSampleDistance(0.5 / (EDGE - 1))
            made.SetImageSampleDistance(1)
            made.SetNumberOfThreads(1)
            made.SetInputData(self.voxels())
            return made
        made.SetInputData(self.mesh)
        return made

    def window(self, name):
        volume, renderer, window = vtk.vtkVolume(), vtk.vtkRenderer(), vtk.vtkRenderWindow()
        volume.SetMapper(self.mapper(name))
        volume.SetProperty(self.property(name != "fixed"))
        renderer.AddVolume(volume)
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(self.camera["size"], self.camera["size"])
        window.AddRenderer(renderer)
        eye, centre, into = renderer.GetActiveCamera(), self.camera["centre"], self.camera["into"]
        eye.ParallelProjectionOn()
        eye.SetParallelScale(self.camera["half_height"])
        eye.SetFocalPoint(*centre)
        eye.SetPosition(*[c - 5 * d for c, d in zip(centre, into)])
        eye.SetViewUp(*self.camera["up"])
        renderer.ResetCameraClippingRange()
        return window

    def frame(self, name):
        first = name not in self.windows
        if first:
            self.windows[name] = self.window(name)
        self.last = self.windows[name]
        for _ in range(2 if first else 1):
            start = time.process_time()
            self.last.GetRenderers().GetFirstRenderer().GetActiveCamera().Modified()
            self.last.Render()
            self.last.WaitForCompletion()
            took = time.process_time() - start
        return took

    def write(self, path):
        shot = vtk.vtkWindowToImageFilter()
        shot.SetInput(self.last)
        shot.SetInputBufferTypeToRGB()
        shot.ReadFrontBufferOff()
        shot.Update()
        size = self.camera["size"]
        red = vtk_to_numpy(shot.GetOutput().GetPointData().GetScalars()).reshape(size, size, 3)[::-1, :, 0]
        with open(path, "wb") as file:
            file.write(red.tobytes())


def main():
    scene = None
    for line in sys.stdin:
        order = line.strip()
        if order == "load":
            with open(sys.argv[2], encoding="utf-8") as file:
                scene = Scene(sys.argv[1], json.load(file))
            answer = 0
        elif order == "write":
            scene.write(sys.argv[3])
            answer = 0
        else:
            answer = scene.frame(order)
        print(f"{answer:.6f}", flush=True)


main()
