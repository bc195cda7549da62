# SPDX-License-Identifier: AGPL-3.0-or-later
"""A smooth field over a tetrahedral mesh, fitted to samples: libgieson-spline with numpy arrays.

    import numpy as np
    import gieson_spline as gs

    space = gs.Space(points, tetrahedra, degree=3)      # or gs.Space.follow(grid, step, edge)
    field, report = space.fit(places, values)
    field(places)                                       # values, NaN outside of the mesh
    field.gradient(places)
    field.segment((0, 0, 0), (1, 1, 1))                 # exact integral along it
    field.save("field.vtkhdf")                          # ParaView opens it

Lengths are in any one unit. Arrays of places have the shape (n, 3), masks and grids (nz, ny, nx), as
numpy has pictures. A failure is a gieson_spline.Error with the library's sentence. Methods that take
`threads` use all processors when it is 0; results are the same for any number.

The library is looked for where the system keeps libraries, or at GIESON_SPLINE_LIBRARY."""
import ctypes
import os

import numpy as np

__all__ = ["Error", "Space", "Field", "Report", "Free", "Volume", "SMOOTHING", "load"]

SMOOTHING = 1e-6
"""What fit() smooths unless told otherwise: it fills what holds no sample."""

_lib = ctypes.CDLL(os.environ.get("GIESON_SPLINE_LIBRARY", "libgieson-spline.so.0"))
_double_p = ctypes.POINTER(ctypes.c_double)


class Error(RuntimeError):
    """The library's sentence; `code` is its word for the kind of failure: "input", "mesh", ..."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


# --- structures, as gieson-spline.h has them ---------------------------------------------------------

class _Error(ctypes.Structure):
    _fields_ = [("code", ctypes.c_int), ("text", ctypes.c_char * 480)]


class _Progress(ctypes.Structure):
    REPORT = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_size_t)
    _fields_ = [("report", REPORT), ("context", ctypes.c_void_p)]


class _Voxels(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t * 3), ("origin", ctypes.c_double * 3),
                ("step", ctypes.c_double * 3), ("inside", ctypes.c_void_p)]


class _SpaceOptions(ctypes.Structure):
    _fields_ = [("degree", ctypes.c_uint), ("cloud", ctypes.c_double), ("knots", ctypes.c_void_p),
                ("mesher", ctypes.c_char_p)]


class _Data(ctypes.Structure):
    _fields_ = [("count", ctypes.c_size_t), ("at", ctypes.c_void_p), ("value", ctypes.c_void_p),
                ("weight", ctypes.c_void_p), ("fold", ctypes.c_void_p)]


class _FieldOptions(ctypes.Structure):
    _fields_ = [("smoothing", ctypes.c_double), ("jump", ctypes.c_double),
                ("tolerance", ctypes.c_double), ("iterations", ctypes.c_uint),
                ("threads", ctypes.c_uint), ("strict", ctypes.c_int), ("progress", ctypes.c_void_p)]


class Report(ctypes.Structure):
    """How a fit went.

    unknowns, samples (those inside of the mesh), outside (samples left out), first_outside, empty_tets
    (tetrahedra without samples), iterations, unconverged (the solver ended above its tolerance), rms,
    worst (residuals), jump (the smoothing that was taken), predicted (with folds: rms error at samples
    of the other fold)."""
    _fields_ = [("unknowns", ctypes.c_size_t), ("samples", ctypes.c_size_t),
                ("outside", ctypes.c_size_t), ("first_outside", ctypes.c_size_t),
                ("empty_tets", ctypes.c_size_t), ("iterations", ctypes.c_uint),
                ("unconverged", ctypes.c_int), ("rms", ctypes.c_double), ("worst", ctypes.c_double),
                ("jump", ctypes.c_double), ("predicted", ctypes.c_double)]

    def __repr__(self):
        return "Report(" + ", ".join(f"{name}={getattr(self, name)}" for name, _ in self._fields_) + ")"


class Free(ctypes.Structure):
    """What moving the knots gained: rms_fixed (as the knots were given), rms_vertices (after the vertices
    had moved), vertex_steps and cloud_steps (that were taken)."""
    _fields_ = [("rms_fixed", ctypes.c_double), ("rms_vertices", ctypes.c_double),
                ("vertex_steps", ctypes.c_uint), ("cloud_steps", ctypes.c_uint)]

    def __repr__(self):
        return "Free(" + ", ".join(f"{name}={getattr(self, name)}" for name, _ in self._fields_) + ")"


class Volume(ctypes.Structure):
    """lower <= the region's volume where the field is above threshold <= upper, guaranteed."""
    _fields_ = [("threshold", ctypes.c_double), ("lower", ctypes.c_double), ("upper", ctypes.c_double)]

    def __repr__(self):
        return f"Volume(threshold={self.threshold}, lower={self.lower}, upper={self.upper})"


def _declare():
    pointer, size, real = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
    for name, answer in {
            "gsn_code_name": ctypes.c_char_p, "gsn_space_free": None, "gsn_space_points": size,
            "gsn_space_tets": size, "gsn_space_knots": pointer, "gsn_space_degree": ctypes.c_uint,
            "gsn_space_unknowns": size, "gsn_field_free": None, "gsn_field_space": pointer,
            "gsn_field_controls": pointer, "gsn_field_hessian": None, "gsn_field_line": real}.items():
        getattr(_lib, name).restype = answer
    for name, takes in {
            "gsn_space_new": [pointer, size, pointer, size, pointer, pointer, pointer],
            "gsn_space_cover": [pointer, real, pointer, pointer, pointer],
            "gsn_space_follow": [pointer, pointer, real, pointer, pointer, pointer],
            "gsn_space_free": [pointer], "gsn_space_points": [pointer, pointer],
            "gsn_space_tets": [pointer, pointer], "gsn_space_knots": [pointer],
            "gsn_space_degree": [pointer], "gsn_space_unknowns": [pointer],
            "gsn_field_fit_many": [pointer, pointer, pointer, size, pointer, pointer, pointer, pointer],
            "gsn_field_fit_free": [pointer, pointer, pointer, ctypes.c_uint] + [pointer] * 4,
            "gsn_field_insert": [pointer] * 4, "gsn_field_new": [pointer] * 4, "gsn_field_free": [pointer], "gsn_field_space": [pointer],
            "gsn_field_controls": [pointer],
            "gsn_field_at": [pointer, pointer, size, ctypes.c_uint, pointer, pointer, pointer],
            "gsn_field_hessian": [pointer, pointer, size, pointer],
            "gsn_field_on_grid": [pointer, pointer, ctypes.c_uint, pointer, pointer],
            "gsn_field_segment": [pointer] * 6, "gsn_field_line": [pointer] * 3,
            "gsn_field_integral": [pointer, ctypes.c_uint, pointer, pointer, pointer],
            "gsn_field_means": [pointer, ctypes.c_uint, pointer, pointer],
            "gsn_field_volume_above": [pointer, pointer, pointer, size, real, ctypes.c_uint, pointer,
                                       pointer, pointer],
            "gsn_field_save": [pointer, ctypes.c_char_p, ctypes.c_char_p, pointer],
            "gsn_field_load": [ctypes.c_char_p, pointer, pointer],
            "gsn_field_write_cells": [pointer, ctypes.c_char_p, pointer],
            "gsn_field_write_surface": [pointer, real, real, ctypes.c_char_p, pointer],
            "gsn_field_write_grid": [pointer, pointer, ctypes.c_char_p, pointer],
            "gsn_code_name": [ctypes.c_int]}.items():
        getattr(_lib, name).argtypes = takes


_declare()


# --- numpy in and out --------------------------------------------------------------------------------

def _call(function, *arguments):
    """Calls a function that takes err last; a failure is raised."""
    err = _Error()
    code = function(*arguments, ctypes.byref(err))
    if code < 0:
        raise Error(_lib.gsn_code_name(code).decode(), err.text.decode("utf-8", "replace"))


def _places(at):
    """(n, 3) doubles; one place is taken as n = 1."""
    at = np.ascontiguousarray(at, dtype=np.float64)
    if at.shape[-1:] != (3,) or at.ndim not in (1, 2):
        raise ValueError(f"places have the shape (n, 3), not {at.shape}")
    return at.reshape(-1, 3)


def _per_sample(numbers, count, what, dtype=np.float64):
    if numbers is None:
        return None
    numbers = np.ascontiguousarray(numbers, dtype=dtype)
    if numbers.shape != (count,):
        raise ValueError(f"{what}: {count} samples have {count} of them, not the shape {numbers.shape}")
    return numbers


def _address(array):
    return None if array is None else array.ctypes.data


def _three(numbers):
    numbers = np.broadcast_to(np.asarray(numbers, dtype=np.float64), (3,))
    return (ctypes.c_double * 3)(*numbers)


def _voxels(shape, step, origin, inside=None):
    """shape is (nz, ny, nx), step and origin (x, y, z) or one number."""
    if len(shape) != 3:
        raise ValueError(f"a grid has three axes, z, y and x, not {len(shape)}")
    return _Voxels((ctypes.c_size_t * 3)(*shape[::-1]), _three(origin), _three(step), _address(inside))


def _mask(mask):
    mask = np.ascontiguousarray(mask)
    return np.ascontiguousarray(mask != 0, dtype=np.uint8)


def _path(path):
    return os.fsencode(path)


def _progress(function):
    """What the library calls; keep it as long as the call."""
    def report(_context, stage, done, total):
        function(stage.decode(), done, total)
    return _Progress(_Progress.REPORT(report), None)


def _borrowed(address, kind, shape):
    """A copy of what the library lends."""
    values = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), shape)
    return values.copy()


# --- where fields live -------------------------------------------------------------------------------

class Space:
    """Where fields live: a tetrahedral mesh, knots around its vertices, a degree from 1 to 3.

    Space(points, tetrahedra) takes (n, 3) coordinates and (m, 4) indices. `cloud` is the radius of the
    knots around a vertex by the smallest altitude of the tetrahedra there (0: 0.015); `knots`, of the
    shape (n, degree + 1, 3), are taken instead."""

    def __init__(self, points, tetrahedra, degree=2, cloud=0.0, knots=None):
        points = _places(points)
        tetrahedra = np.ascontiguousarray(tetrahedra, dtype=np.uint32)
        if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4:
            raise ValueError(f"tetrahedra have the shape (m, 4), not {tetrahedra.shape}")
        if knots is not None:
            knots = np.ascontiguousarray(knots, dtype=np.float64)
            if knots.shape != (len(points), degree + 1, 3):
                raise ValueError(f"knots have the shape {(len(points), degree + 1, 3)}, not {knots.shape}")
        options = _SpaceOptions(degree, cloud, _address(knots), None)
        self._handle = ctypes.c_void_p()
        self._owner = None
        _call(_lib.gsn_space_new, points.ctypes.data, len(points), tetrahedra.ctypes.data,
              len(tetrahedra), ctypes.byref(options), ctypes.byref(self._handle))

    @classmethod
    def _of(cls, handle, owner=None):
        """owner: the field whose space it is; it then frees nothing."""
        space = cls.__new__(cls)
        space._handle, space._owner = handle, owner
        return space

    @classmethod
    def cover(cls, mask, step, edge, origin=0.0, degree=2, cloud=0.0, mesher=None):
        """A space over tetrahedra of about this edge that cover the voxels of a mask (nz, ny, nx).

        step is the distance of voxel centres and origin the first one's place, each (x, y, z) or one
        number. The mesh is made by gieson-mesh, of the package gieson; mesher is its path when it is
        not installed."""
        inside = _mask(mask)
        voxels = _voxels(inside.shape, step, origin, inside)
        options = _SpaceOptions(degree, cloud, None, None if mesher is None else _path(mesher))
        handle = ctypes.c_void_p()
        _call(_lib.gsn_space_cover, ctypes.byref(voxels), edge, ctypes.byref(options),
              ctypes.byref(handle))
        return cls._of(handle)

    @classmethod
    def follow(cls, values, step, edge, mask=None, origin=0.0, degree=2, cloud=0.0, mesher=None):
        """A space over tetrahedra that follow values (nz, ny, nx; NaN: none) in the voxels of a mask.

        Along walls, where values fall from one plateau to another within few voxels, faces lie in
        layers beside the wall: a field then needs several times fewer unknowns. edge is about that of
        the triangles there and around the mask; the rest as in cover()."""
        values = np.ascontiguousarray(values, dtype=np.float64)
        inside = None if mask is None else _mask(mask)
        if inside is not None and inside.shape != values.shape:
            raise ValueError(f"a mask of the shape {values.shape}, not {inside.shape}")
        voxels = _voxels(values.shape, step, origin, inside)
        options = _SpaceOptions(degree, cloud, None, None if mesher is None else _path(mesher))
        handle = ctypes.c_void_p()
        _call(_lib.gsn_space_follow, ctypes.byref(voxels), values.ctypes.data, edge,
              ctypes.byref(options), ctypes.byref(handle))
        return cls._of(handle)

    def __del__(self):
        if getattr(self, "_handle", None) and self._owner is None:
            _lib.gsn_space_free(self._handle)

    @property
    def points(self):
        """Vertices, (n, 3)."""
        lent = ctypes.c_void_p()
        count = _lib.gsn_space_points(self._handle, ctypes.byref(lent))
        return _borrowed(lent, ctypes.c_double, (count, 3))

    @property
    def tetrahedra(self):
        """Indices of their corners, (m, 4), oriented positively."""
        lent = ctypes.c_void_p()
        count = _lib.gsn_space_tets(self._handle, ctypes.byref(lent))
        return _borrowed(lent, ctypes.c_uint32, (count, 4))

    @property
    def knots(self):
        """(n, degree + 1, 3); the first of each is the vertex."""
        return _borrowed(_lib.gsn_space_knots(self._handle), ctypes.c_double,
                         (_lib.gsn_space_points(self._handle, None), self.degree + 1, 3))

    @property
    def degree(self):
        """1, 2 or 3."""
        return _lib.gsn_space_degree(self._handle)

    @property
    def unknowns(self):
        """How many control values make a field."""
        return _lib.gsn_space_unknowns(self._handle)

    def field(self, controls):
        """The field of these control values."""
        controls = _per_sample(controls, self.unknowns, "control values")
        handle = ctypes.c_void_p()
        _call(_lib.gsn_field_new, self._handle, controls.ctypes.data, ctypes.byref(handle))
        return Field._of(handle, self)

    def fit(self, places, values, weights=None, folds=None, smoothing=SMOOTHING, jump=0.0,
            tolerance=0.0, iterations=0, threads=0, strict=False, progress=None):
        """(field, report) of samples: places (n, 3), values (n,).

        weights (n,) weigh the squares: 1 / variance; 2 is the same sample twice. folds (n,) of 0 and 1:
        the smoothing is chosen so that each half predicts the other best. smoothing 0 is none, and
        then every control value needs samples near it. strict: a sample outside of the mesh and a
        solver that does not reach its tolerance are errors; otherwise the report has them.
        progress(stage, done, total) is told where the work is.

        Values of the shape (channels, n) are as many fits at once: lists of fields and reports."""
        places = _places(places)
        values = np.ascontiguousarray(values, dtype=np.float64)
        single = values.ndim == 1
        values = np.atleast_2d(values)
        if values.ndim != 2 or values.shape[1] != len(places):
            raise ValueError(f"{len(places)} samples have values of the shape ({len(places)},) or "
                             f"(channels, {len(places)}), not {values.shape}")
        weights = _per_sample(weights, len(places), "weights")
        folds = _per_sample(folds, len(places), "folds", np.uint8)
        told = None if progress is None else _progress(progress)
        data = _Data(len(places), places.ctypes.data, None, _address(weights), _address(folds))
        options = _FieldOptions(smoothing, jump, tolerance, iterations, threads, strict,
                                None if told is None else ctypes.addressof(told))
        channels = len(values)
        each = (ctypes.c_void_p * channels)(*(row.ctypes.data for row in values))
        made, reports = (ctypes.c_void_p * channels)(), (Report * channels)()
        _call(_lib.gsn_field_fit_many, self._handle, ctypes.byref(data), each, channels,
              ctypes.byref(options), made, reports)
        fields = [Field._of(ctypes.c_void_p(handle), self) for handle in made]
        reports = [Report.from_buffer_copy(report) for report in reports]
        return (fields[0], reports[0]) if single else (fields, reports)

    def fit_free(self, places, values, weights=None, folds=None, steps=0, smoothing=SMOOTHING, jump=0.0,
                 tolerance=0.0, iterations=0, threads=0, strict=False):
        """(field, report, free) of samples as of fit(), in a space of its own whose knots have moved to
        where they leave less of the samples: vertices inside of the mesh in at most so many steps (0:
        16), then single knots in a quarter as many. Each step is several fits."""
        places = _places(places)
        values = _per_sample(values, len(places), "values")
        weights = _per_sample(weights, len(places), "weights")
        folds = _per_sample(folds, len(places), "folds", np.uint8)
        data = _Data(len(places), places.ctypes.data, values.ctypes.data, _address(weights), _address(folds))
        options = _FieldOptions(smoothing, jump, tolerance, iterations, threads, strict, None)
        handle, free, report = ctypes.c_void_p(), Free(), Report()
        _call(_lib.gsn_field_fit_free, self._handle, ctypes.byref(data), ctypes.byref(options), steps,
              ctypes.byref(handle), ctypes.byref(free), ctypes.byref(report))
        return Field._of(handle, None), report, free


# --- fields ------------------------------------------------------------------------------------------

class Field:
    """A smooth field; made by Space.fit(), Space.fit_free(), Space.field(), insert() and load()."""

    def __init__(self):
        raise TypeError("fields are made by Space.fit(), Space.field() and load()")

    @classmethod
    def _of(cls, handle, space):
        field = cls.__new__(cls)
        field._handle, field._kept = handle, space
        return field

    def __del__(self):
        if getattr(self, "_handle", None):
            _lib.gsn_field_free(self._handle)

    @property
    def space(self):
        """The space it lives in."""
        if self._kept is not None:
            return self._kept
        return Space._of(ctypes.c_void_p(_lib.gsn_field_space(self._handle)), owner=self)

    @property
    def controls(self):
        """Its control values."""
        return _borrowed(_lib.gsn_field_controls(self._handle), ctypes.c_double, (self.space.unknowns,))

    def insert(self, knots):
        """The same field with one vertex more, in a space of its own: knots (degree + 1, 3), the first
        the vertex, inside of a tetrahedron, the others its cloud. Nothing changes anywhere."""
        knots = _places(knots)
        if len(knots) != self.space.degree + 1:
            raise ValueError(f"a vertex of degree {self.space.degree} has {self.space.degree + 1} knots, "
                             f"not {len(knots)}")
        handle = ctypes.c_void_p()
        _call(_lib.gsn_field_insert, self._handle, knots.ctypes.data, ctypes.byref(handle))
        return Field._of(handle, None)

    def _at(self, places, threads, with_gradient):
        at = _places(places)
        value = np.empty(len(at))
        gradient = np.empty((len(at), 3)) if with_gradient else None
        _call(_lib.gsn_field_at, self._handle, at.ctypes.data, len(at), threads, value.ctypes.data,
              _address(gradient))
        return value, gradient

    def __call__(self, places, threads=0):
        """Values at places (n, 3), NaN outside of the mesh; one number at one place."""
        value = self._at(places, threads, False)[0]
        return value[0] if np.ndim(places) == 1 else value

    def gradient(self, places, threads=0):
        """Gradients at places, (n, 3); (3,) at one place."""
        gradient = self._at(places, threads, True)[1]
        return gradient[0] if np.ndim(places) == 1 else gradient

    def hessian(self, places):
        """Second derivatives at places, (n, 3, 3); (3, 3) at one place."""
        at = _places(places)
        six = np.empty((len(at), 6))
        _lib.gsn_field_hessian(self._handle, at.ctypes.data, len(at), six.ctypes.data)
        full = six[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        return full[0] if np.ndim(places) == 1 else full

    def on_grid(self, shape, step, origin=0.0, threads=0):
        """Values at the voxel centres of a grid of the shape (nz, ny, nx); step and origin are
        (x, y, z) or one number. NaN outside of the mesh."""
        grid = _voxels(shape, step, origin)
        value = np.empty(shape)
        _call(_lib.gsn_field_on_grid, self._handle, ctypes.byref(grid), threads, value.ctypes.data)
        return value

    def segment(self, a, b):
        """(integral, length): along the segment from a to b, and how long it runs in the mesh."""
        integral, length = ctypes.c_double(), ctypes.c_double()
        _call(_lib.gsn_field_segment, self._handle, _three(a), _three(b), ctypes.byref(integral),
              ctypes.byref(length))
        return integral.value, length.value

    def line(self, p, d):
        """The integral along the whole line p + t d."""
        return _lib.gsn_field_line(self._handle, _three(p), _three(d))

    def integral(self, threads=0):
        """(integral, volume): over the whole mesh."""
        integral, volume = ctypes.c_double(), ctypes.c_double()
        _call(_lib.gsn_field_integral, self._handle, threads, ctypes.byref(integral),
              ctypes.byref(volume))
        return integral.value, volume.value

    def means(self, threads=0):
        """The mean over each tetrahedron, (m,)."""
        mean = np.empty(_lib.gsn_space_tets(_lib.gsn_field_space(self._handle), None))
        _call(_lib.gsn_field_means, self._handle, threads, mean.ctypes.data)
        return mean

    def volume_above(self, thresholds, mask, step, origin=0.0, gap=0.0, threads=0, progress=None):
        """Bounds of the volume of a mask's voxels (nz, ny, nx) where the field is above each threshold:
        a list of Volume, or one for one threshold. gap: wanted (upper - lower) / upper; 0: 1e-3."""
        inside = _mask(mask)
        voxels = _voxels(inside.shape, step, origin, inside)
        wanted = np.ascontiguousarray(np.atleast_1d(thresholds), dtype=np.float64)
        told = None if progress is None else _progress(progress)
        volumes = (Volume * len(wanted))()
        _call(_lib.gsn_field_volume_above, self._handle, ctypes.byref(voxels), wanted.ctypes.data,
              len(wanted), gap, threads, None if told is None else ctypes.addressof(told), volumes)
        found = [Volume.from_buffer_copy(volume) for volume in volumes]
        return found[0] if np.ndim(thresholds) == 0 else found

    def save(self, path, name=""):
        """To a .vtkhdf file, to the last bit; ParaView opens it."""
        _call(_lib.gsn_field_save, self._handle, name.encode(), _path(path))

    def write_cells(self, path):
        """The tetrahedra, as .vtu or .csv."""
        _call(_lib.gsn_field_write_cells, self._handle, _path(path))

    def write_surface(self, path, level, error=0.0):
        """The surface where the field has the level, as .stl or .ply; no triangle lies farther from
        it than error (0: a hundredth of the mean edge of the tetrahedra)."""
        _call(_lib.gsn_field_write_surface, self._handle, level, error, _path(path))

    def write_grid(self, path, shape, step, origin=0.0):
        """The values of on_grid(), as .nrrd, .nii or .nii.gz."""
        grid = _voxels(shape, step, origin)
        _call(_lib.gsn_field_write_grid, self._handle, ctypes.byref(grid), _path(path))


def load(path):
    """The field of a .vtkhdf file that Field.save() or gieson has written. Not for files of strangers:
    HDF5 is no reader for hostile bytes."""
    handle = ctypes.c_void_p()
    _call(_lib.gsn_field_load, _path(path), ctypes.byref(handle))
    return Field._of(handle, None)
