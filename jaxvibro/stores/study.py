"""Define the protocol of a study, a grid of cells in chunks, and complete studies with an engine."""

import hashlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import xarray as xr

from continuation.branch_segment import UNLIMITED, Limits

from ..scene import check
from .engines import Engine, LocalEngine


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


MAX_BYTES = 4 << 30  # largest size of a study that is kept in memory
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


class Progress(NamedTuple):
    """Progress of a running study.

    Attributes
    ----------
    done : int
        Number of computed cells.
    total : int
        Number of cells.
    undecided : int
        Number of computed cells whose result is undecided.
    rate : float
        Cells per second in this run.
    remaining : float
        Remaining time at this rate, in s; nan before the first chunk of this run.

    Examples
    --------
    >>> reports = []
    >>> data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]}, quantities="label", progress=reports.append)
    >>> reports[-1].done, reports[-1].total, reports[-1].undecided
    (2, 2, 0)
    """

    done: int
    total: int
    undecided: int
    rate: float
    remaining: float


@runtime_checkable
class OpenStore(Protocol):
    """Protocol of a store that is open for a study."""

    @property
    def frame(self) -> xr.Dataset: ...

    def undecided_counts(self) -> dict[int, int]:
        """Return {chunk number: number of undecided cells} for the completed chunks."""

    def undecided_count(self, chunk_number: int) -> int | None:
        """Return the number of undecided cells of a completed chunk; None for other chunks."""

    def put(self, chunk_number: int, chunk_columns: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store the columns of a chunk and its number of undecided cells."""

    def data(self) -> xr.Dataset:
        """Return the frame of the study with the columns of all cells."""


@runtime_checkable
class Store(Protocol):
    """Protocol of a store of a study, with its execution engine; `open` raises an error for another study."""

    @property
    def engine(self) -> Engine: ...
    def open(self, study: Study) -> OpenStore: ...


class InMemoryStore:
    """Store that keeps a study in memory."""

    def __init__(self, study: Study) -> None:
        n_bytes = study_size_bytes(study)
        if n_bytes > MAX_BYTES:
            rule = f"must be given for results of more than {MAX_BYTES >> 30} GiB"
            raise check.ArgumentError("store", rule, f"{n_bytes / 2**30:.3g} GiB in memory")
        self.study, self.columns, self.undecided_count_by_chunk = (
            study,
            blank_columns(study.columns, study.grid.shape),
            dict[int, int](),
        )

    @property
    def frame(self) -> xr.Dataset:
        """Frame of the study."""
        return self.study.frame

    def undecided_counts(self) -> dict[int, int]:
        """Return {chunk number: number of undecided cells} for the completed chunks."""
        return self.undecided_count_by_chunk

    def undecided_count(self, chunk_number: int) -> int | None:
        """Return the number of undecided cells of a completed chunk; None for other chunks."""
        return self.undecided_count_by_chunk.get(chunk_number)

    def put(self, chunk_number: int, chunk_columns: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store the columns of a chunk and its number of undecided cells."""
        for column_name, chunk_column in chunk_columns.items():
            self.columns[column_name][self.study.grid.chunk_slices(chunk_number)] = chunk_column
        self.undecided_count_by_chunk[chunk_number] = n_undecided

    def data(self) -> xr.Dataset:
        """Return the frame of the study with the columns of all cells."""
        variables = {
            column_name: ((*self.study.grid.sizes, *column.more), self.columns[column_name], dict(column.attrs))
            for column_name, column in self.study.columns.items()
        }
        return self.study.frame.assign(variables)


@dataclass(frozen=True)
class ChunkTask:
    """Function of a chunk number that computes and stores the chunk; an engine calls it.

    Parameters
    ----------
    study : Study
        Study to compute.
    store : OpenStore
        Store that is open for the study. It may be sent to another process.
    """

    study: Study
    store: OpenStore

    def __call__(self, chunk_number: int) -> tuple[int, int]:
        """Compute and store a chunk unless it is complete; return (chunk number, number of undecided cells)."""
        stored_count = self.store.undecided_count(chunk_number)
        if stored_count is not None:  # done by a worker that was lost afterwards
            return chunk_number, stored_count
        chunk_columns, n_undecided = self.study.compute(chunk_number, self.store.frame)
        self.store.put(chunk_number, chunk_columns, n_undecided)
        return chunk_number, n_undecided


def spread_chunk_order(n_chunks: int) -> list[int]:
    """Return the numbers of all chunks in an order that samples the grid evenly.

    The computation rate of the first chunks then predicts the remaining time, and the last chunks are not all in the
    slowest region.
    """
    return np.argsort(np.arange(n_chunks) * GOLDEN_RATIO % 1.0).tolist()


def complete_study(
    study: Study,
    store: Store | None,
    progress_callback: Callable[[Progress], object] | None,
    time_limits: Limits = UNLIMITED,
) -> xr.Dataset:
    """Complete a study: compute the chunks that are missing in its store.

    Parameters
    ----------
    study : Study
        Study to complete.
    store : Store or None
        Store. None keeps the study in memory.
    progress_callback : callable or None
        Function that is called with a `Progress` at the start and after each chunk.
    time_limits : Limits, optional
        Time limit, after which no further chunk is started. The missing cells are then blank, and the attribute
        ``stopped`` states the reason.

    Returns
    -------
    xarray.Dataset
        Frame and columns of all cells. The values of a computed cell do not depend on timing, not even in the last bit.
        A later run with the same store computes the missing cells.

    Raises
    ------
    ArgumentError
        If the study is too large for memory, or the store belongs to another study.
    """
    open_store, engine = (InMemoryStore(study), LocalEngine()) if store is None else (store.open(study), store.engine)
    grid, done_chunks = study.grid, dict(open_store.undecided_counts())
    n_cells, n_done_cells = (
        int(np.prod(grid.shape)),
        sum(grid.n_chunk_cells(chunk_number) for chunk_number in done_chunks),
    )
    n_undecided, n_cells_done_before, start_time = sum(done_chunks.values()), n_done_cells, time.monotonic()
    missing_chunk_numbers = (
        chunk_number for chunk_number in spread_chunk_order(grid.n_chunks) if chunk_number not in done_chunks
    )
    chunks_within_limits = takewhile(lambda chunk_number: not time_limits.expired, missing_chunk_numbers)

    def report_progress():
        """Call `progress_callback` with the current progress."""
        if progress_callback is not None:
            cells_per_second = (n_done_cells - n_cells_done_before) / max(time.monotonic() - start_time, 1e-9)
            progress_callback(
                Progress(
                    n_done_cells,
                    n_cells,
                    n_undecided,
                    cells_per_second,
                    (n_cells - n_done_cells) / cells_per_second if cells_per_second else float("nan"),
                )
            )

    report_progress()
    for chunk_number, n_new_undecided in (
        engine.each(ChunkTask(study, open_store), chunks_within_limits) if len(done_chunks) < grid.n_chunks else ()
    ):
        n_done_cells, n_undecided = n_done_cells + grid.n_chunk_cells(chunk_number), n_undecided + n_new_undecided
        report_progress()
    dataset = open_store.data()
    return (
        dataset
        if n_done_cells == n_cells
        else dataset.assign_attrs(stopped=f"max_seconds reached: {n_done_cells} of {n_cells} cells done")
    )
