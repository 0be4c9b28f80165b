"""Define execution engines, which call a function for each chunk number, and the engine of this process.

The function does not depend on the engine, and the engine does not depend on the study. In the engine of this process
a thread computes a whole chunk on one device, so that no device waits for the slowest lanes of another device.
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
    """Protocol of an execution engine, which computes chunks in the precision of its caller."""

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """Yield work(number) for each number, in order of completion; an error ends the iteration."""


@dataclass(frozen=True)
class LocalEngine:
    """Execution engine that computes chunks with threads of this process.

    The engine uses all local devices of JAX, or the device of `jax.default_device` if it is set.

    Parameters
    ----------
    workers : int, optional
        Number of chunks computed at the same time. None means one per device. On a CPU, None means three for every two
        usable cores, so that the cores are busy while threads wait for each other in Python.
    devices : int, optional
        Number of devices. None uses all devices.

    Raises
    ------
    ArgumentError
        If an argument is not a positive integer.

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
                check.check_whole_number(name, getattr(self, name), 1)

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """Yield the results of a function of chunk numbers, in order of completion.

        Parameters
        ----------
        work : callable
            Function of a chunk number.
        numbers : iterable of int
            Chunk numbers.

        Yields
        ------
        object
            Result of `work` for one of the numbers.
        """
        jax_default, use_x64 = default_device(), jax.config.read("jax_enable_x64")
        devices = (
            [jax_default]
            if isinstance(jax_default, jax.Device)
            else jax.local_devices(backend=jax_default)[: self.devices]
        )
        n_workers = self.workers or max(len(devices), 3 * n_usable_cores() // 2 if devices[0].platform == "cpu" else 1)
        free_devices: SimpleQueue = SimpleQueue()
        for device in islice(cycle(devices), n_workers):
            free_devices.put(device if len(devices) > 1 else jax_default)

        def run_on_free_device(chunk_number):
            """Compute a chunk on a free device."""
            device = free_devices.get()
            try:
                with jax.enable_x64(use_x64), nullcontext() if device is None else jax.default_device(device):
                    return work(chunk_number)
            finally:
                free_devices.put(device)

        with ThreadPoolExecutor(n_workers) as thread_pool:
            yield from run_in_flight(
                lambda chunk_number: thread_pool.submit(run_on_free_device, chunk_number),
                numbers,
                n_workers * CHUNKS_PER_THREAD,
            )


class SerialPool:
    """Substitute for a thread pool that runs in the calling thread, where thread-local settings of JAX hold."""

    map = staticmethod(map)


def run_in_flight(submit_chunk, chunk_numbers, max_in_flight):
    """Yield the results of the futures that `submit_chunk` returns for chunk numbers, in order of completion.

    At most `max_in_flight` futures are pending at the same time. The first error cancels the others.
    """
    pending_numbers, running_futures = iter(chunk_numbers), set()
    try:
        running_futures.update(submit_chunk(chunk_number) for chunk_number in islice(pending_numbers, max_in_flight))
        while running_futures:
            done_futures, running_futures = wait(running_futures, return_when=FIRST_COMPLETED)
            for future in done_futures:
                yield future.result()
            running_futures.update(
                submit_chunk(chunk_number)
                for chunk_number in islice(pending_numbers, max_in_flight - len(running_futures))
            )
    finally:
        for future in running_futures:
            future.cancel()


def default_device():
    """Return the device or platform name that `jax.default_device` sets; None if it is not set."""
    return jax.config.jax_default_device


def n_usable_cores():
    """Return the number of cores that this process may use.

    Returns
    -------
    int
        Number of cores.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
