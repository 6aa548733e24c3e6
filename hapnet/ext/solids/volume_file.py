"""Reads voxels from files: distances from numpy, images of a scanner (NRRD, NIfTI, MetaImage, DICOM) by SimpleITK."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.solids.mesh_file import LARGEST_M, SMALLEST_M, require_file
from hapnet.file_content import open_plain
from hapnet.loading import cause

NUMPY = ".npy"
IMAGES = (".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".gz", ".dcm")
MOST_VOXELS = 30_000_000
_LARGEST_HEADER = 4096  # of a numpy file [bytes]

_EXACT_VOXELS = 1.5
"""Within this distance of the surface the distance is computed from the image's values, to a fraction of a voxel."""


def is_volume(file: str) -> bool:
    """Whether this is a file of voxels or a directory of DICOM slices, not a ``module:function``."""
    return file.lower().endswith((NUMPY, *IMAGES)) or Path(file).is_dir()


def read_volume(file: str, unit_m: float, spacing_m: float | None, iso: float | None) -> tuple[Array, Array]:
    """Signed distances (nx, ny, nz) [m], below 0 inside, and the spacing (3,) [m].

    file : distances in a numpy file, or an image. unit_m : of both [m]. spacing_m : of a numpy file [m]; an image has
    its own. iso : voxels of this value or more are inside; None: the numbers are distances.

    Raises InvalidParameter, MissingLibrary.
    """
    values, spacing = _numpy(file, spacing_m) if file.lower().endswith(NUMPY) else _image(file, unit_m, spacing_m)
    if values.ndim != 3 or min(values.shape) < 2 or values.size > MOST_VOXELS or not np.isfinite(values).all():
        allowed = f"three axes with two or more finite numbers each, {MOST_VOXELS} at most"
        raise InvalidParameter("voxels", f"{file}, {' x '.join(map(str, values.shape))}", allowed)
    extent = float(max((np.array(values.shape) - 1) * spacing))
    if not SMALLEST_M <= extent <= LARGEST_M:
        allowed = f"{1e3 * SMALLEST_M:g} mm to {LARGEST_M:g} m: are unit and spacing right?"
        raise InvalidParameter("size", f"{file}, {extent:.3g} m", allowed)
    distances = unit_m * values if iso is None else _distances(values - iso, spacing)
    if not (distances < 0.0).any() or not (distances > 0.0).any():
        low, high = float(values.min()), float(values.max())
        what = "distances, below 0 inside" if iso is None else f"iso= between {low:g} and {high:g}"
        raise InvalidParameter("voxels", f"{file}: {low:g} to {high:g}", f"a surface: {what}")
    return distances, spacing


def _numpy(file: str, spacing_m: float | None) -> tuple[Array, Array]:
    require_file(file)
    if spacing_m is None or not spacing_m > 0.0:
        raise InvalidParameter("spacing", spacing_m or "none", "the distance between two voxels: &spacing=1mm")
    try:
        values = np.asarray(_array(file), dtype=np.float64)
    except Exception as error:  # for a broken header numpy may raise any error
        raise InvalidParameter("voxels", file, f"numbers in numpy's format ({cause(error)})") from None
    return values, np.full(3, spacing_m)


def _array(file: str) -> Array:
    """The array in a numpy file. Its header is not trusted: the file must have as many bytes as it announces."""
    with open_plain(file) as content:
        version = np.lib.format.read_magic(content)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_columns, kind = read(content, max_header_size=_LARGEST_HEADER)
        there = os.fstat(content.fileno()).st_size - content.tell()
        size = math.prod(shape)
        if kind.kind not in "fiub" or min(shape, default=0) < 0 or size > MOST_VOXELS or size * kind.itemsize != there:
            raise ValueError(f"{there} bytes of data, where {' x '.join(map(str, shape))} of {kind} are announced")
        return np.frombuffer(content.read(there), kind).reshape(shape, order="F" if by_columns else "C")


def _image(file: str, unit_m: float, spacing_m: float | None) -> tuple[Array, Array]:
    if spacing_m is not None:
        raise InvalidParameter("spacing", spacing_m, "", why=f"{file} has its own; leave it out")
    try:
        import SimpleITK as sitk  # noqa: N813  # as its documents name it
    except ImportError:
        raise MissingLibrary("a volume that is no numpy file", "SimpleITK scipy", "volume") from None
    library: Any = sitk
    library.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        if Path(file).is_dir():
            reader = library.ImageSeriesReader()
            reader.SetFileNames(reader.GetGDCMSeriesFileNames(file))
            image = reader.Execute()
        else:
            require_file(file)
            reader = library.ImageFileReader()
            reader.SetFileName(file)
            reader.ReadImageInformation()  # check the announced size before memory is allocated
            if math.prod(reader.GetSize()) > MOST_VOXELS:
                voxels = " x ".join(map(str, reader.GetSize()))
                raise InvalidParameter("voxels", f"{file}, {voxels}", f"{MOST_VOXELS} at most")
            image = reader.Execute()
        values = np.asarray(library.GetArrayFromImage(image), dtype=np.float64)
    except RuntimeError as error:
        raise InvalidParameter("voxels", file, f"an image that can be read ({cause(error)[-200:]})") from None
    return values.T, unit_m * np.array(image.GetSpacing()[:3], dtype=np.float64)


def _distances(above: Array, spacing: Array) -> Array:
    """Signed distances [m] to where `above` is 0; it is above 0 inside."""
    try:
        from scipy.ndimage import distance_transform_edt
    except ImportError:
        raise MissingLibrary("a volume with iso=", "SimpleITK scipy", "volume") from None
    inside = above >= 0.0
    step = float(min(spacing))
    far: Array = distance_transform_edt(~inside, sampling=spacing) - distance_transform_edt(inside, sampling=spacing)
    far -= 0.5 * step * np.sign(far)  # the surface lies between two voxels
    along_x, along_y, along_z = np.gradient(above, *spacing)
    steep: Array = np.sqrt(along_x**2 + along_y**2 + along_z**2)
    close = (np.abs(far) < _EXACT_VOXELS * step) & (steep > 0.0)
    exact = -above[close] / steep[close]
    far[close] = np.clip(exact, -2.0 * step, 2.0 * step)
    return far
