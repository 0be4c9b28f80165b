"""Protect saved files with a format number and a checksum over all their bytes.

The checksum is stored in the file itself, as an attribute or a key. It is the SHA-256 digest of the file's bytes, with
a blank checksum in place of the checksum. Every flipped bit is therefore detected, even in padding. Any
reader of NetCDF or JSON can read the file.
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
_CHECKSUM_MARKERS = (b"sha256:", b"checksum")  # no single damage removes both


def fill_in_checksum(content):
    """Replace the blank checksum in the content of a file by the checksum of this content.

    Parameters
    ----------
    content : bytes
        Content with `HEADER_ATTRIBUTES`, whose checksum is blank.

    Returns
    -------
    bytes
        Content with the checksum.
    """
    return content.replace(BLANK_CHECKSUM.encode(), b"sha256:" + sha256_hex(content).encode(), 1)


def netcdf_bytes(data):
    """Return a Dataset as the bytes of a NetCDF file (classic format) with a checksum.

    The format has no dimensions of size 0. A dataset without impacts is therefore padded with one impact of zeros.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset.

    Returns
    -------
    bytes
        Content of the file.
    """
    impact_padding = {"impact": (0, 1)} if data.sizes.get("impact") == 0 else {}
    padded_dataset = data.pad(impact_padding, constant_values=0).assign_attrs()
    padded_dataset.attrs = HEADER_ATTRIBUTES | data.attrs | HEADER_ATTRIBUTES
    return fill_in_checksum(bytes(padded_dataset.to_netcdf(engine="scipy")))


def has_valid_checksum(content, path):
    """Check the checksum of a file; return False for a file of format 1, which has none.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : path_like
        Name of the file, for the error message.

    Returns
    -------
    bool
        True if the file has a valid checksum, False if it has no checksum.

    Raises
    ------
    ArgumentError
        If the checksum is wrong.
    """
    checksum_match = _CHECKSUM_PATTERN.search(content)
    if checksum_match is None and not any(checksum_marker in content for checksum_marker in _CHECKSUM_MARKERS):
        return False
    if (
        checksum_match is None
        or checksum_match[0]
        != b"sha256:" + sha256_hex(content.replace(checksum_match[0], BLANK_CHECKSUM.encode(), 1)).encode()
    ):
        raise ArgumentError("path", "must be unchanged since it was written; its checksum does not match", str(path))
    return True


def parse_checked_file(path, parse):
    """Check the checksum of a file and return parse(content, path).

    A file of format 1 has no checksum; if it can be parsed, the function issues a warning. The warning points to the
    user's line if the caller is a public function that `host_only` decorates.

    Parameters
    ----------
    path : path_like
        File.
    parse : callable
        Function of the content, in bytes, and the path.

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


def require_known_format(format_number, path):
    """Raise ArgumentError if a format number is invalid or belongs to a later version.

    Parameters
    ----------
    format_number : int or None
        Format number in the file. None means format 1.
    path : path_like
        Name of the file, for the error message.
    """
    if format_number is not None and (
        np.ndim(format_number) or isinstance(format_number, bool) or format_number not in range(1, FORMAT_NUMBER + 1)
    ):
        raise ArgumentError(
            "path", f"must be of format {FORMAT_NUMBER} or earlier", f"format {format_value(format_number)} in {path}"
        )


@host_only("use data that were loaded before")
def load_data(path: str | PathLike[str]) -> xr.Dataset:
    """Load a dataset from a NetCDF file of jaxvibro, after checking its checksum.

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
        If the file is damaged, is not a NetCDF file, or has the format of a later version.
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
    return parse_checked_file(path, parse_dataset)


def parse_dataset(content, path):
    """Parse the content of a NetCDF file; raise ArgumentError if it is invalid."""
    try:
        dataset = xr.load_dataset(content, engine="scipy")
    except Exception as error:  # readers raise different errors for different kinds of damage
        raise ArgumentError("path", f"must be a NetCDF file ({type(error).__name__})", str(path)) from None
    require_known_format(dataset.attrs.get("format"), path)
    return dataset


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
