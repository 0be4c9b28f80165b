"""Protect saved files with a format number and a checksum over all their bytes.

The checksum is stored in the file itself, as an attribute or a key: SHA-256 of the file's bytes with a blank checksum
in its place. So every flipped bit is detected, also in padding, and any reader of NetCDF or JSON reads the file.
"""

import hashlib
import re
import warnings
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from ..scene.check import ArgumentError, format_value, host_only

FORMAT_NUMBER = 2  # files of format 1 had neither number nor checksum
BLANK_CHECKSUM = "sha256:" + 64 * "0"
HEADER_ATTRIBUTES = {
    "format": FORMAT_NUMBER,
    "checksum": BLANK_CHECKSUM,
}  # first attributes of a file, so that no similar bytes precede them
_CHECKSUM_PATTERN = re.compile(rb"sha256:[0-9a-f]{64}")
_CHECKSUM_TRACES = (b"sha256:", b"checksum")  # no single damage removes both


def seal(content):
    """Return the bytes of a file that holds `HEADER_ATTRIBUTES`, with the checksum filled in.

    Parameters
    ----------
    content : bytes
        File with a blank checksum.

    Returns
    -------
    bytes
        File with its checksum.
    """
    return content.replace(BLANK_CHECKSUM.encode(), b"sha256:" + sha256_hex(content).encode(), 1)


def netcdf_bytes(data):
    """Return a Dataset as the bytes of a sealed NetCDF file (classic format).

    The format has no dimensions of size 0, so datasets of orbits without impacts are padded with one impact of zeros.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset.

    Returns
    -------
    bytes
        Content of the file.
    """
    padding = {"impact": (0, 1)} if data.sizes.get("impact") == 0 else {}
    dataset = data.pad(padding, constant_values=0).assign_attrs()
    dataset.attrs = HEADER_ATTRIBUTES | data.attrs | HEADER_ATTRIBUTES
    return seal(bytes(dataset.to_netcdf(engine="scipy")))


def has_valid_checksum(content, path):
    """Return True if a file has a checksum and it is right; False for a file of format 1.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : path_like
        Name of the file, for the error.

    Returns
    -------
    bool
        True for a valid checksum, False without one.

    Raises
    ------
    ArgumentError
        If the checksum is wrong.
    """
    match = _CHECKSUM_PATTERN.search(content)
    if match is None and not any(trace in content for trace in _CHECKSUM_TRACES):
        return False
    if (
        match is None
        or match[0] != b"sha256:" + sha256_hex(content.replace(match[0], BLANK_CHECKSUM.encode(), 1)).encode()
    ):
        raise ArgumentError("path", "must be unchanged since it was written; its checksum does not match", str(path))
    return True


def read_checked(path, parse):
    """Return parse(content, path) of a file after checking its checksum.

    A file of format 1 that can be parsed causes a warning. It names the user's line if this function is called by a
    public function that `host_only` decorates.

    Parameters
    ----------
    path : path_like
        File.
    parse : callable
        Function of the bytes and the path.

    Returns
    -------
    object
        Result of `parse`.
    """
    content = Path(path).read_bytes()
    has_checksum, result = has_valid_checksum(content, path), parse(content, path)
    if not has_checksum:
        warnings.warn(
            f"{path}: has no checksum, like all files of format 1; damage would not be detected", stacklevel=4
        )
    return result


def require_format(format_number, path):
    """Raise ArgumentError for an invalid format number or one of a later version; None is that of format 1.

    Parameters
    ----------
    format_number : int or None
        Format number in the file.
    path : path_like
        Name of the file, for the error.
    """
    if format_number is not None and (
        np.ndim(format_number) or isinstance(format_number, bool) or format_number not in range(1, FORMAT_NUMBER + 1)
    ):
        raise ArgumentError(
            "path", f"must be of format {FORMAT_NUMBER} or earlier", f"format {format_value(format_number)} in {path}"
        )


@host_only("use data that were loaded before")
def load_data(path: str | PathLike[str]) -> xr.Dataset:
    """Load a dataset that `run` or `paper` saved, after checking its checksum.

    A file of format 1, which has no checksum, is loaded with a warning.

    Parameters
    ----------
    path : path_like
        NetCDF file.

    Returns
    -------
    xarray.Dataset
        Content of the file.

    Raises
    ------
    ArgumentError
        If the file is damaged or is not a NetCDF file.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     branch.save(f"{folder}/branch.nc")
    ...     data = jv.load_data(f"{folder}/branch.nc")
    >>> data["amplitude"].shape == branch.values.shape
    True
    """
    return read_checked(path, parse_dataset)


def parse_dataset(content, path):
    """Return the Dataset of a NetCDF file's bytes; raise ArgumentError if it cannot be read."""
    try:
        data = xr.load_dataset(content, engine="scipy")
    except Exception as error:  # readers raise different errors for different kinds of damage
        raise ArgumentError("path", f"must be a NetCDF file ({type(error).__name__})", str(path)) from None
    require_format(data.attrs.get("format"), path)
    return data


def sha256_hex(content):
    """Return the SHA-256 digest of bytes as 64 hexadecimal digits.

    Parameters
    ----------
    content : bytes
        Bytes.

    Returns
    -------
    str
        Digest.
    """
    return hashlib.sha256(content).hexdigest()
