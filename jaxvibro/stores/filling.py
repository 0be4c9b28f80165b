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
from .study import Study, blank, size_in_bytes

MOST_BYTES = 4 << 30  # of a study that is kept in memory alone
GOLDEN = (5.0**0.5 - 1.0) / 2.0


class Progress(NamedTuple):
    """How far a study is: cells done, cells in all, cells done that are undecided, cells a second in this run, seconds
    that are left at that rate (nan before the first)."""

    done: int
    total: int
    undecided: int
    rate: float
    remaining: float


@runtime_checkable
class Kept(Protocol):
    """A store that is open for a study."""

    @property
    def frame(self) -> xr.Dataset: ...

    def undecided(self) -> dict[int, int]:
        """{number: undecided cells} of the chunks that are done."""

    def undecided_of(self, number: int) -> int | None:
        """Undecided cells of a chunk that is done, None of another."""

    def put(self, number: int, parts: dict[str, np.ndarray], undecided: int) -> None:
        """Keeps a chunk, once."""

    def data(self) -> xr.Dataset:
        """The frame, and the columns of all cells."""


@runtime_checkable
class Store(Protocol):
    """Where a study can be kept; `open` refuses another one's."""

    @property
    def engine(self) -> Engine: ...
    def open(self, study: Study) -> Kept: ...


class InMemory:
    """A study that is kept in memory."""

    def __init__(self, study: Study) -> None:
        size = size_in_bytes(study)
        if size > MOST_BYTES:
            rule = f"must be given for results of more than {MOST_BYTES >> 30} GiB"
            raise check.ArgumentError("store", rule, f"{size / 2**30:.3g} GiB in memory")
        self.study, self.columns, self.done = study, blank(study.columns, study.grid.shape), dict[int, int]()

    @property
    def frame(self) -> xr.Dataset:
        return self.study.frame

    def undecided(self) -> dict[int, int]:
        return self.done

    def undecided_of(self, number: int) -> int | None:
        return self.done.get(number)

    def put(self, number: int, parts: dict[str, np.ndarray], undecided: int) -> None:
        for name, part in parts.items():
            self.columns[name][self.study.grid.cut(number)] = part
        self.done[number] = undecided

    def data(self) -> xr.Dataset:
        variables = {
            name: ((*self.study.grid.sizes, *one.more), self.columns[name], dict(one.attrs))
            for name, one in self.study.columns.items()
        }
        return self.study.frame.assign(variables)


@dataclass(frozen=True)
class Work:
    """What an engine calls: chunk number -> how many of its cells are undecided, once it is kept.

    kept: a store open for the study, which may be sent to another process.
    """

    study: Study
    kept: Kept

    def __call__(self, number: int) -> tuple[int, int]:
        known = self.kept.undecided_of(number)
        if known is not None:  # a worker that was lost had done it
            return number, known
        parts, undecided = self.study.compute(number, self.kept.frame)
        self.kept.put(number, parts, undecided)
        return number, undecided


def spread(chunks: int) -> list[int]:
    """All numbers of chunks, in an order whose beginnings are spread evenly over the grid: what is done is a sample of
    it, whose rate tells the time left, and the last ones are not all from where cells take longest."""
    return np.argsort(np.arange(chunks) * GOLDEN % 1.0).tolist()


def done(
    study: Study, store: Store | None, progress: Callable[[Progress], object] | None, limits: Limits = UNLIMITED
) -> xr.Dataset:
    """All of a study: what a store has of it already is not done again.

    store: None for memory alone. limits: no chunk is begun once their time is used up; the cells of the others are then
    blank, and the attribute `stopped` says why. No chunk's bits depend on timing, and a later run goes on.

    Raises what the store's `open` raises, and ArgumentError for what is too large for memory.
    """
    kept, engine = (InMemory(study), LocalEngine()) if store is None else (store.open(study), store.engine)
    grid, known = study.grid, dict(kept.undecided())
    total, count = int(np.prod(grid.shape)), sum(grid.cells(number) for number in known)
    undecided, before, began = sum(known.values()), count, time.monotonic()
    wanted = (number for number in spread(grid.chunks) if number not in known)
    missing = takewhile(lambda number: not limits.expired, wanted)

    def report():
        if progress is not None:
            rate = (count - before) / max(time.monotonic() - began, 1e-9)
            progress(Progress(count, total, undecided, rate, (total - count) / rate if rate else float("nan")))

    report()
    for number, more in engine.each(Work(study, kept), missing) if len(known) < grid.chunks else ():
        count, undecided = count + grid.cells(number), undecided + more
        report()
    found = kept.data()
    return (
        found if count == total else found.assign_attrs(stopped=f"max_seconds reached: {count} of {total} cells done")
    )
