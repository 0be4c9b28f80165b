"""What a study of very many cells is: a grid cut into chunks, each a pure function of its number."""

import hashlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np


class Column(NamedTuple):
    """What is worked out for each cell. dtype: of its numbers; blank: that of a cell not yet done; more: the names and
    sizes of the dimensions that it has besides the grid's; attrs: as of an xarray variable."""

    dtype: np.dtype
    blank: float
    attrs: Mapping[str, Any]
    more: Mapping[str, int] = {}


class Grid(NamedTuple):
    """The cells. sizes: {dimension: cells along it}; chunk_shape: how many of them along each a chunk has, fewer at an
    end.

    Chunks are numbered row by row, the last dimension fastest.
    """

    sizes: Mapping[str, int]
    chunk_shape: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each dimension."""
        return tuple(self.sizes.values())

    @property
    def chunk_counts(self) -> tuple[int, ...]:
        """Chunks along each dimension."""
        return tuple(-(-size // chunk_size) for size, chunk_size in zip(self.shape, self.chunk_shape, strict=True))

    @property
    def n_chunks(self) -> int:
        """How many there are."""
        return math.prod(self.chunk_counts)

    def chunk_slices(self, number: int) -> tuple[slice, ...]:
        """Which cells a chunk has, along each dimension."""
        indices = np.unravel_index(number, self.chunk_counts)
        axes = zip(indices, self.chunk_shape, self.shape, strict=True)
        return tuple(
            slice(int(index) * chunk_size, min((int(index) + 1) * chunk_size, size)) for index, chunk_size, size in axes
        )

    def n_cells(self, number: int) -> int:
        """How many cells a chunk has."""
        return math.prod(axis_slice.stop - axis_slice.start for axis_slice in self.chunk_slices(number))


@runtime_checkable
class Study(Protocol):
    """A study: a frozen record that can be sent to another process.

    grid: the cells; columns: what each of them gets; identity: texts that tell this study from any other, the scene
    among them; frame: what is known before, an xarray.Dataset: coordinates, attributes, and variables without a
    dimension of the grid, all that a chunk needs and that is not computed to the same bits twice.
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
        """(what each cell of a chunk gets, how many of them are undecided): the same bits each time it is asked."""


def fingerprint_axis(values: np.ndarray) -> str:
    """Numbers as a text that tells them from others: how many there are, the ends, a digest."""
    ends = f"{values.flat[0].item()!r} to {values.flat[-1].item()!r}" if values.size else "none"
    return f"{values.size}, {ends}, {hashlib.sha256(values.tobytes()).hexdigest()[:16]}"


def study_bytes(study: Study) -> int:
    """Of all columns together."""
    n_cells = math.prod(study.grid.shape)
    return sum(
        n_cells * math.prod(column.more.values()) * np.dtype(column.dtype).itemsize for column in study.columns.values()
    )


def blank_columns(columns: Mapping[str, Column], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """The columns of so many cells of which none is done."""
    return {
        name: np.full((*shape, *column.more.values()), column.blank, column.dtype) for name, column in columns.items()
    }
