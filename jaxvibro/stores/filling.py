"""Complete a study: compute its missing chunks with an engine and return all of it as an xarray.Dataset."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import xarray as xr

from continuation.limits import UNLIMITED, Limits

from ..scene import check
from .engines import Engine, LocalEngine
from .study import Study, blank_columns, study_bytes

MAX_BYTES = 4 << 30  # largest size of a study that is kept in memory
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


class Progress(NamedTuple):
    """Progress of a study.

    Attributes
    ----------
    done : int
        Number of cells done.
    total : int
        Number of cells.
    undecided : int
        Number of cells that are done and undecided.
    rate : float
        Cells per second in this run.
    remaining : float
        Remaining time at this rate, in s; nan before the first chunk.

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
        """Return {number: undecided cells} of the chunks that are done."""

    def undecided_count(self, number: int) -> int | None:
        """Return the number of undecided cells of a chunk that is done, None for another."""

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store a chunk."""

    def data(self) -> xr.Dataset:
        """Return the frame and the columns of all cells."""


@runtime_checkable
class Store(Protocol):
    """Protocol of a place that keeps a study; `open` refuses another study's place."""

    @property
    def engine(self) -> Engine: ...
    def open(self, study: Study) -> OpenStore: ...


class InMemory:
    """Study that is kept in memory."""

    def __init__(self, study: Study) -> None:
        size = study_bytes(study)
        if size > MAX_BYTES:
            rule = f"must be given for results of more than {MAX_BYTES >> 30} GiB"
            raise check.ArgumentError("store", rule, f"{size / 2**30:.3g} GiB in memory")
        self.study, self.columns, self.count_of_chunk = (
            study,
            blank_columns(study.columns, study.grid.shape),
            dict[int, int](),
        )

    @property
    def frame(self) -> xr.Dataset:
        """Frame of the study."""
        return self.study.frame

    def undecided_counts(self) -> dict[int, int]:
        """Return {number: undecided cells} of the chunks that are done."""
        return self.count_of_chunk

    def undecided_count(self, number: int) -> int | None:
        """Return the number of undecided cells of a chunk that is done, None for another."""
        return self.count_of_chunk.get(number)

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store a chunk."""
        for name, part in parts.items():
            self.columns[name][self.study.grid.chunk_slices(number)] = part
        self.count_of_chunk[number] = n_undecided

    def data(self) -> xr.Dataset:
        """Return the frame and the columns of all cells."""
        variables = {
            name: ((*self.study.grid.sizes, *column.more), self.columns[name], dict(column.attrs))
            for name, column in self.study.columns.items()
        }
        return self.study.frame.assign(variables)


@dataclass(frozen=True)
class ChunkTask:
    """Function that an engine calls: computes and stores a chunk.

    Parameters
    ----------
    study : Study
        Study.
    store : OpenStore
        Store that is open for the study. It may be sent to another process.
    """

    study: Study
    store: OpenStore

    def __call__(self, number: int) -> tuple[int, int]:
        """Compute and store a chunk unless it is done; return (number, undecided cells)."""
        known_count = self.store.undecided_count(number)
        if known_count is not None:  # done by a worker that was lost afterwards
            return number, known_count
        parts, n_undecided = self.study.compute(number, self.store.frame)
        self.store.put(number, parts, n_undecided)
        return number, n_undecided


def spread_chunks(n_chunks: int) -> list[int]:
    """Return the numbers of all chunks in an order that samples the grid evenly.

    The first chunks are a sample of the grid, whose rate predicts the remaining time, and the last ones are not all
    from the slowest region.
    """
    return np.argsort(np.arange(n_chunks) * GOLDEN_RATIO % 1.0).tolist()


def complete_study(
    study: Study, store: Store | None, progress: Callable[[Progress], object] | None, limits: Limits = UNLIMITED
) -> xr.Dataset:
    """Complete a study, without recomputing the chunks that its store already has.

    Parameters
    ----------
    study : Study
        Study.
    store : Store or None
        Store. None keeps the study in memory.
    progress : callable or None
        Called with a `Progress` after each chunk.
    limits : Limits, optional
        Time limit, after which no chunk is started. The other cells are then blank, and the attribute ``stopped`` gives
        the reason.

    Returns
    -------
    xarray.Dataset
        Frame and columns of all cells. The bits of a chunk do not depend on timing, and a later run resumes.

    Raises
    ------
    ArgumentError
        If the study is too large for memory, or the store refuses it.
    """
    open_store, engine = (InMemory(study), LocalEngine()) if store is None else (store.open(study), store.engine)
    grid, done_chunks = study.grid, dict(open_store.undecided_counts())
    n_cells, n_done = int(np.prod(grid.shape)), sum(grid.n_cells(number) for number in done_chunks)
    n_undecided, n_done_before, start_time = sum(done_chunks.values()), n_done, time.monotonic()
    missing_chunks = (number for number in spread_chunks(grid.n_chunks) if number not in done_chunks)
    chunk_queue = takewhile(lambda number: not limits.expired, missing_chunks)

    def report():
        """Report the progress."""
        if progress is not None:
            rate = (n_done - n_done_before) / max(time.monotonic() - start_time, 1e-9)
            progress(Progress(n_done, n_cells, n_undecided, rate, (n_cells - n_done) / rate if rate else float("nan")))

    report()
    for number, n_new_undecided in (
        engine.each(ChunkTask(study, open_store), chunk_queue) if len(done_chunks) < grid.n_chunks else ()
    ):
        n_done, n_undecided = n_done + grid.n_cells(number), n_undecided + n_new_undecided
        report()
    dataset = open_store.data()
    return (
        dataset
        if n_done == n_cells
        else dataset.assign_attrs(stopped=f"max_seconds reached: {n_done} of {n_cells} cells done")
    )
