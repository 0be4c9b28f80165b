"""Define a study of many cells: a grid cut into chunks, each a pure function of its number."""

import hashlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np


class Column(NamedTuple):
    """Quantity that is computed for each cell.

    Parameters
    ----------
    dtype : dtype
        Type of its numbers.
    blank : float
        Value of a cell that is not done.
    attrs : mapping
        Attributes of the xarray variable.
    more : mapping of str to int, optional
        Names and sizes of its dimensions besides those of the grid.
    """

    dtype: np.dtype
    blank: float
    attrs: Mapping[str, Any]
    more: Mapping[str, int] = {}


class Grid(NamedTuple):
    """Grid of cells, cut into chunks.

    Chunks are numbered row by row, the last dimension fastest.

    Parameters
    ----------
    sizes : mapping of str to int
        Number of cells along each dimension.
    chunk_shape : tuple of int
        Number of cells of a chunk along each dimension; the last chunk may be smaller.
    """

    sizes: Mapping[str, int]
    chunk_shape: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each dimension."""
        return tuple(self.sizes.values())

    @property
    def chunk_counts(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-size // chunk_size) for size, chunk_size in zip(self.shape, self.chunk_shape, strict=True))

    @property
    def n_chunks(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunk_counts)

    def chunk_slices(self, number: int) -> tuple[slice, ...]:
        """Return the slices of a chunk's cells along each dimension."""
        indices = np.unravel_index(number, self.chunk_counts)
        axes = zip(indices, self.chunk_shape, self.shape, strict=True)
        return tuple(
            slice(int(index) * chunk_size, min((int(index) + 1) * chunk_size, size)) for index, chunk_size, size in axes
        )

    def n_cells(self, number: int) -> int:
        """Return the number of cells of a chunk."""
        return math.prod(axis_slice.stop - axis_slice.start for axis_slice in self.chunk_slices(number))


@runtime_checkable
class Study(Protocol):
    """Protocol of a study: a frozen record that can be sent to another process.

    Attributes
    ----------
    grid : Grid
        Cells.
    columns : mapping of str to Column
        Quantities of each cell.
    identity : mapping of str to str
        Texts that identify the study, the scene among them.
    frame : xarray.Dataset
        Data known before the computation: coordinates, attributes, and variables without a dimension of the grid. It
        includes everything that a chunk needs and that is not reproducible bit by bit.
    """

    @property
    def grid(self) -> Grid: ...
    @property
    def columns(self) -> Mapping[str, Column]: ...
    @property
    def identity(self) -> Mapping[str, str]: ...
    @property
    def frame(self) -> Any: ...

    def compute(self, number: int, frame: Any) -> tuple[dict[str, np.ndarray], int]:
        """Return (columns of a chunk, number of undecided cells): the same bits at each call."""


def fingerprint_axis(values: np.ndarray) -> str:
    """Return a text that identifies an array: number of values, first and last value, and a digest.

    Parameters
    ----------
    values : ndarray
        Array.

    Returns
    -------
    str
        Text.
    """
    ends = f"{values.flat[0].item()!r} to {values.flat[-1].item()!r}" if values.size else "none"
    return f"{values.size}, {ends}, {hashlib.sha256(values.tobytes()).hexdigest()[:16]}"


def study_bytes(study: Study) -> int:
    """Return the size in bytes of all columns together."""
    n_cells = math.prod(study.grid.shape)
    return sum(
        n_cells * math.prod(column.more.values()) * np.dtype(column.dtype).itemsize for column in study.columns.values()
    )


def blank_columns(columns: Mapping[str, Column], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return the columns of cells of which none is done.

    Parameters
    ----------
    columns : mapping of str to Column
        Columns of the study.
    shape : tuple of int
        Shape of the cells.

    Returns
    -------
    dict of str to ndarray
        Blank columns.
    """
    return {
        name: np.full((*shape, *column.more.values()), column.blank, column.dtype) for name, column in columns.items()
    }
