"""Define the protocol of a study: a grid of cells in chunks, each a pure function of its number."""

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
        Data type.
    blank : float
        Value of a cell that has not been computed.
    attrs : mapping
        Attributes of the xarray variable.
    more : mapping of str to int, optional
        Names and sizes of the dimensions besides those of the grid.
    """

    dtype: np.dtype
    blank: float
    attrs: Mapping[str, Any]
    more: Mapping[str, int] = {}


class Grid(NamedTuple):
    """Grid of cells, divided into chunks.

    Chunks are numbered in C order: the index of the last dimension varies fastest.

    Parameters
    ----------
    sizes : mapping of str to int
        Number of cells along each dimension.
    chunk_shape : tuple of int
        Number of cells of a chunk along each dimension. The last chunk along a dimension may be smaller.
    """

    sizes: Mapping[str, int]
    chunk_shape: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each dimension, in order."""
        return tuple(self.sizes.values())

    @property
    def chunk_counts(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(
            -(-axis_size // chunk_size) for axis_size, chunk_size in zip(self.shape, self.chunk_shape, strict=True)
        )

    @property
    def n_chunks(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunk_counts)

    def chunk_slices(self, chunk_number: int) -> tuple[slice, ...]:
        """Return the slice of cells of a chunk along each dimension."""
        chunk_indices = np.unravel_index(chunk_number, self.chunk_counts)
        index_and_sizes_by_axis = zip(chunk_indices, self.chunk_shape, self.shape, strict=True)
        return tuple(
            slice(int(chunk_index) * chunk_size, min((int(chunk_index) + 1) * chunk_size, axis_size))
            for chunk_index, chunk_size, axis_size in index_and_sizes_by_axis
        )

    def n_chunk_cells(self, chunk_number: int) -> int:
        """Return the number of cells of a chunk."""
        return math.prod(axis_slice.stop - axis_slice.start for axis_slice in self.chunk_slices(chunk_number))


@runtime_checkable
class Study(Protocol):
    """Protocol of a study, an immutable record that can be sent to another process.

    Attributes
    ----------
    grid : Grid
        Grid of the cells.
    columns : mapping of str to Column
        Quantities that are computed for each cell.
    identity : mapping of str to str
        Texts that identify the study, for example the scene.
    frame : xarray.Dataset
        Data that are known before the computation: coordinates, attributes, and variables without a dimension of the
        grid. They include all inputs of a chunk that are not reproducible bit by bit.
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
        """Return (columns of a chunk, number of undecided cells); the results must be reproducible bit by bit."""


def fingerprint_array(array_values: np.ndarray) -> str:
    """Return a text that identifies an array by its number of values, its first and last value, and a digest.

    Parameters
    ----------
    array_values : ndarray
        Array of any shape.

    Returns
    -------
    str
        Identifying text.
    """
    end_values_text = (
        f"{array_values.flat[0].item()!r} to {array_values.flat[-1].item()!r}" if array_values.size else "none"
    )
    return f"{array_values.size}, {end_values_text}, {hashlib.sha256(array_values.tobytes()).hexdigest()[:16]}"


def study_size_bytes(study: Study) -> int:
    """Return the total size of all columns of a study, in bytes."""
    n_cells = math.prod(study.grid.shape)
    return sum(
        n_cells * math.prod(column.more.values()) * np.dtype(column.dtype).itemsize for column in study.columns.values()
    )


def blank_columns(study_columns: Mapping[str, Column], cells_shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return columns with blank values for all cells.

    Parameters
    ----------
    study_columns : mapping of str to Column
        Columns of the study.
    cells_shape : tuple of int
        Shape of the array of cells.

    Returns
    -------
    dict of str to ndarray
        Blank columns.
    """
    return {
        column_name: np.full((*cells_shape, *column.more.values()), column.blank, column.dtype)
        for column_name, column in study_columns.items()
    }
