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

from ..scene.check import ArgumentError, format_value, host_only

FORMAT_NUMBER = 2  # of the files; those of format 1 had neither number nor checksum
BLANK_CHECKSUM = "sha256:" + 64 * "0"
HEADER_ATTRIBUTES = {
    "format": FORMAT_NUMBER,
    "checksum": BLANK_CHECKSUM,
}  # what a file begins with, so that nothing before them is like them
_CHECKSUM_PATTERN = re.compile(rb"sha256:[0-9a-f]{64}")
_CHECKSUM_TRACES = (b"sha256:", b"checksum")  # no single damage takes both


def seal(content):
    """The bytes of a file that holds `HEADER_ATTRIBUTES`, with the checksum filled in."""
    return content.replace(BLANK_CHECKSUM.encode(), b"sha256:" + sha256_hex(content).encode(), 1)


def netcdf_bytes(data):
    """An xarray.Dataset as the bytes of a sealed NetCDF file (classic format), which knows no dimension without places:
    where orbits have no impacts there is room for one, of zeros."""
    padding = {"impact": (0, 1)} if data.sizes.get("impact") == 0 else {}
    dataset = data.pad(padding, constant_values=0).assign_attrs()
    dataset.attrs = HEADER_ATTRIBUTES | data.attrs | HEADER_ATTRIBUTES
    return seal(bytes(dataset.to_netcdf(engine="scipy")))


def has_valid_checksum(content, path):
    """Whether a file has a checksum, which is then right; False for a file of format 1.

    Raises ArgumentError where the checksum is wrong.
    """
    match = _CHECKSUM_PATTERN.search(content)
    if match is None and not any(trace in content for trace in _CHECKSUM_TRACES):
        return False
    if (
        match is None
        or match[0] != b"sha256:" + sha256_hex(content.replace(match[0], BLANK_CHECKSUM.encode(), 1)).encode()
    ):
        raise ArgumentError("path", "must be as it was written, which its checksum says it is not", str(path))
    return True


def read_checked(path, parse):
    """What read(content, path) gives of a file's bytes, once their checksum is right.

    Called by what a user calls, through `host_only`: where the file is of format 1 and can be read, the warning names
    the user's line."""
    content = Path(path).read_bytes()
    has_checksum, result = has_valid_checksum(content, path), parse(content, path)
    if not has_checksum:
        warnings.warn(f"{path}: has no checksum, as files of before: damage would go unnoticed", stacklevel=4)
    return result


def require_format(format_number, path):
    """Refuse a format that is none, or of a later version; None is that of before."""
    if format_number is not None and (
        np.ndim(format_number) or isinstance(format_number, bool) or format_number not in range(1, FORMAT_NUMBER + 1)
    ):
        raise ArgumentError(
            "path", f"must be of format {FORMAT_NUMBER} or before", f"format {format_value(format_number)} in {path}"
        )


@host_only("use what was loaded before")
def load_data(path: str | PathLike[str]) -> xr.Dataset:
    """The xarray.Dataset of a NetCDF file that `run` or `paper` wrote, once its checksum is right.

    A file of before, without a checksum, is read with a warning. Raises ArgumentError where the file is damaged or none
    of NetCDF, OSError where it cannot be read.
    """
    return read_checked(path, parse_dataset)


def parse_dataset(content, path):
    """The Dataset of a NetCDF file's bytes. Raises ArgumentError."""
    try:
        data = xr.load_dataset(content, engine="scipy")
    except Exception as error:  # the readers fall over damage of many kinds, each with an error of its own
        raise ArgumentError("path", f"must be a NetCDF file ({type(error).__name__})", str(path)) from None
    require_format(data.attrs.get("format"), path)
    return data


def sha256_hex(content):
    """SHA-256 of bytes, 64 letters."""
    return hashlib.sha256(content).hexdigest()
