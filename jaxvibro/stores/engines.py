"""Execution engines: an engine calls a function with the numbers of chunks and returns its results.

The function does not depend on the engine, nor the engine on the study. This module has the engine of this process. One
thread computes a chunk on one device from beginning to end, so that no device waits for the slowest lanes of another.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import cycle, islice
from queue import SimpleQueue
from typing import Protocol, TypeVar, runtime_checkable

import jax

from ..scene import check

Result = TypeVar("Result")
CHUNKS_PER_THREAD = 2  # chunks submitted for each thread


@runtime_checkable
class Engine(Protocol):
    """Protocol of an engine, which computes chunks in the precision of its caller."""

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """Yield work(number) for each number, as it is completed; the first error ends it after the running chunks."""


@dataclass(frozen=True)
class LocalEngine:
    """Execution engine that computes chunks with threads of this process.

    It uses all devices of JAX, or that of `jax.default_device`.

    Parameters
    ----------
    workers : int, optional
        Number of chunks computed at the same time. None takes one for each device; on a CPU it takes three for every
        two usable cores, since only one thread at a time can run Python while the others compute.
    devices : int, optional
        Number of devices. None takes all of them.

    Raises
    ------
    ArgumentError
        If a number is invalid.

    See Also
    --------
    DaskEngine : Engine that computes chunks on a Dask cluster.

    Examples
    --------
    >>> store = jv.Store("map.zarr", jv.LocalEngine(workers=2))
    >>> store.engine
    LocalEngine(workers=2, devices=None)
    """

    workers: int | None = None
    devices: int | None = None

    def __post_init__(self) -> None:
        for name in ("workers", "devices"):
            if getattr(self, name) is not None:
                check.whole_number(name, getattr(self, name), 1)

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """Yield the results of a function of chunk numbers, as they are completed.

        Parameters
        ----------
        work : callable
            Function of a chunk number.
        numbers : iterable of int
            Chunk numbers.

        Yields
        ------
        object
            Result of `work` for one of the numbers, in order of completion.
        """
        default, use_x64 = default_device(), jax.config.read("jax_enable_x64")
        devices = [default] if isinstance(default, jax.Device) else jax.local_devices(backend=default)[: self.devices]
        workers = self.workers or max(len(devices), 3 * n_usable_cores() // 2 if devices[0].platform == "cpu" else 1)
        free_devices: SimpleQueue = SimpleQueue()
        for device in islice(cycle(devices), workers):
            free_devices.put(device if len(devices) > 1 else default)

        def on_device(number):
            """Run one chunk on a free device."""
            device = free_devices.get()
            try:
                with jax.enable_x64(use_x64), nullcontext() if device is None else jax.default_device(device):
                    return work(number)
            finally:
                free_devices.put(device)

        with ThreadPoolExecutor(workers) as pool:
            yield from run_in_flight(
                lambda number: pool.submit(on_device, number), numbers, workers * CHUNKS_PER_THREAD
            )


class SerialPool:
    """Replacement of a thread pool that runs in this thread, so that thread-local settings such as precision hold."""

    map = staticmethod(map)


def run_in_flight(submit, numbers, max_in_flight):
    """Yield the results of the futures submit(number) as they are completed, with at most `max_in_flight` running.

    The first error cancels the rest.
    """
    pending_numbers, running = iter(numbers), set()
    try:
        running.update(submit(number) for number in islice(pending_numbers, max_in_flight))
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
            running.update(submit(number) for number in islice(pending_numbers, max_in_flight - len(running)))
    finally:
        for future in running:
            future.cancel()


def default_device():
    """Return the device of `jax.default_device`, or the name of its platform; None if JAX may choose."""
    return jax.config.jax_default_device


def n_usable_cores():
    """Return the number of cores that this process may use.

    Returns
    -------
    int
        Number of cores.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
