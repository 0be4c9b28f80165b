"""A study done: what is missing of it is worked out by an engine, and all of it given back as an xarray.Dataset."""

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

MAX_BYTES = 4 << 30  # of a study that is kept in memory alone
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


class Progress(NamedTuple):
    """How far a study is: cells done, cells in all, cells done that are undecided, cells a second in this run, seconds
    that are left at that rate (nan before the first)."""

    done: int
    total: int
    undecided: int
    rate: float
    remaining: float


@runtime_checkable
class OpenStore(Protocol):
    """A store that is open for a study."""

    @property
    def frame(self) -> xr.Dataset: ...

    def undecided_counts(self) -> dict[int, int]:
        """{number: undecided cells} of the chunks that are done."""

    def undecided_count(self, number: int) -> int | None:
        """Undecided cells of a chunk that is done, None of another."""

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        """Keeps a chunk, once."""

    def data(self) -> xr.Dataset:
        """The frame, and the columns of all cells."""


@runtime_checkable
class Store(Protocol):
    """Where a study can be kept; `open` refuses another one's."""

    @property
    def engine(self) -> Engine: ...
    def open(self, study: Study) -> OpenStore: ...


class InMemory:
    """A study that is kept in memory."""

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
        return self.study.frame

    def undecided_counts(self) -> dict[int, int]:
        return self.count_of_chunk

    def undecided_count(self, number: int) -> int | None:
        return self.count_of_chunk.get(number)

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        for name, part in parts.items():
            self.columns[name][self.study.grid.chunk_slices(number)] = part
        self.count_of_chunk[number] = n_undecided

    def data(self) -> xr.Dataset:
        variables = {
            name: ((*self.study.grid.sizes, *column.more), self.columns[name], dict(column.attrs))
            for name, column in self.study.columns.items()
        }
        return self.study.frame.assign(variables)


@dataclass(frozen=True)
class ChunkTask:
    """What an engine calls: chunk number -> how many of its cells are undecided, once it is kept.

    store: a store open for the study, which may be sent to another process.
    """

    study: Study
    store: OpenStore

    def __call__(self, number: int) -> tuple[int, int]:
        known_count = self.store.undecided_count(number)
        if known_count is not None:  # a worker that was lost had done it
            return number, known_count
        parts, n_undecided = self.study.compute(number, self.store.frame)
        self.store.put(number, parts, n_undecided)
        return number, n_undecided


def spread_chunks(n_chunks: int) -> list[int]:
    """All numbers of chunks, in an order whose beginnings are spread evenly over the grid: what is done is a sample of
    it, whose rate tells the time left, and the last ones are not all from where cells take longest."""
    return np.argsort(np.arange(n_chunks) * GOLDEN_RATIO % 1.0).tolist()


def complete_study(
    study: Study, store: Store | None, progress: Callable[[Progress], object] | None, limits: Limits = UNLIMITED
) -> xr.Dataset:
    """All of a study: what a store has of it already is not done again.

    store: None for memory alone. limits: no chunk is begun once their time is used up; the cells of the others are then
    blank, and the attribute `stopped` says why. No chunk's bits depend on timing, and a later run goes on.

    Raises what the store's `open` raises, and ArgumentError for what is too large for memory.
    """
    open_store, engine = (InMemory(study), LocalEngine()) if store is None else (store.open(study), store.engine)
    grid, done_chunks = study.grid, dict(open_store.undecided_counts())
    n_cells, n_done = int(np.prod(grid.shape)), sum(grid.n_cells(number) for number in done_chunks)
    n_undecided, n_done_before, start_time = sum(done_chunks.values()), n_done, time.monotonic()
    missing_chunks = (number for number in spread_chunks(grid.n_chunks) if number not in done_chunks)
    chunk_queue = takewhile(lambda number: not limits.expired, missing_chunks)

    def report():
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
