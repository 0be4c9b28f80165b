"""Saved files that tell whether they are what was written: a format number, and a checksum over all their bytes.

The checksum stands in the file itself, as an attribute or a key: SHA-256 of the file's bytes with a blank one in its
place. So every flipped bit is told, those in padding too, and any reader of NetCDF or JSON reads the file.
"""

import hashlib
import re
import warnings
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from ..scene.check import ArgumentError, host, shown

FORMAT = 2  # of the files; those of format 1 had neither number nor checksum
BLANK = "sha256:" + 64 * "0"
MARKS = {"format": FORMAT, "checksum": BLANK}  # what a file begins with, so that nothing before them is like them
_SEAL = re.compile(rb"sha256:[0-9a-f]{64}")
_TRACES = (b"sha256:", b"checksum")  # no single damage takes both


def sealed(content):
    """The bytes of a file that holds `MARKS`, with the checksum filled in."""
    return content.replace(BLANK.encode(), b"sha256:" + digest(content).encode(), 1)


def netcdf(data):
    """An xarray.Dataset as the bytes of a sealed NetCDF file (classic format), which knows no dimension without places:
    where orbits have no impacts there is room for one, of zeros."""
    none = {"impact": (0, 1)} if data.sizes.get("impact") == 0 else {}
    marked = data.pad(none, constant_values=0).assign_attrs()
    marked.attrs = MARKS | data.attrs | MARKS
    return sealed(bytes(marked.to_netcdf(engine="scipy")))


def is_sealed(content, path):
    """Whether a file has a checksum, which is then right; False for a file of format 1.

    Raises ArgumentError where the checksum is wrong.
    """
    found = _SEAL.search(content)
    if found is None and not any(trace in content for trace in _TRACES):
        return False
    if found is None or found[0] != b"sha256:" + digest(content.replace(found[0], BLANK.encode(), 1)).encode():
        raise ArgumentError("path", "must be as it was written, which its checksum says it is not", str(path))
    return True


def opened(path, read):
    """What read(content, path) gives of a file's bytes, once their checksum is right.

    Called by what a user calls, through `host`: where the file is of format 1 and can be read, the warning names the
    user's line.
    """
    content = Path(path).read_bytes()
    known, found = is_sealed(content, path), read(content, path)
    if not known:
        warnings.warn(f"{path}: has no checksum, as files of before: damage would go unnoticed", stacklevel=4)
    return found


def is_format(number, path):
    """Refuse a format that is none, or of a later version; None is that of before."""
    if number is not None and (np.ndim(number) or isinstance(number, bool) or number not in range(1, FORMAT + 1)):
        raise ArgumentError("path", f"must be of format {FORMAT} or before", f"format {shown(number)} in {path}")


@host("use what was loaded before")
def load_data(path: str | PathLike[str]) -> xr.Dataset:
    """The xarray.Dataset of a NetCDF file that `run` or `paper` wrote, once its checksum is right.

    A file of before, without a checksum, is read with a warning. Raises ArgumentError where the file is damaged or none
    of NetCDF, OSError where it cannot be read.
    """
    return opened(path, dataset_of)


def dataset_of(content, path):
    """The Dataset of a NetCDF file's bytes. Raises ArgumentError."""
    try:
        data = xr.load_dataset(content, engine="scipy")
    except Exception as error:  # the readers fall over damage of many kinds, each with an error of its own
        raise ArgumentError("path", f"must be a NetCDF file ({type(error).__name__})", str(path)) from None
    is_format(data.attrs.get("format"), path)
    return data


def digest(content):
    """SHA-256 of bytes, 64 letters."""
    return hashlib.sha256(content).hexdigest()
