"""Who works a study's chunks out: an engine hands a function numbers of chunks, and gives back what it returns.

The function says nothing of engines, and engines nothing of studies. Here is that of this process: a chunk is worked
out by one thread on one device from beginning to end, so that no device waits for another's slowest lanes.
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
CHUNKS_PER_THREAD = 2  # chunks of a thread that are handed out before the first is back


@runtime_checkable
class Engine(Protocol):
    """Works chunks out, in the precision of whoever asks for them."""

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """What work(number) returns for each of some numbers, as it comes in; the first error ends it, once what has
        been begun is done."""


@dataclass(frozen=True)
class LocalEngine:
    """Works chunks out in this process, on all of jax's devices or that of `jax.default_device`.

    workers: chunks at a time; None: one for each device, on a processor three for every two of its cores that may be
    used: while some wait for Python, which one thread at a time can run, others compute.
    devices: how many of these take part, None for all. Raises ArgumentError for numbers that cannot be.
    """

    workers: int | None = None
    devices: int | None = None

    def __post_init__(self) -> None:
        for name in ("workers", "devices"):
            if getattr(self, name) is not None:
                check.whole_number(name, getattr(self, name), 1)

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """What work(number) returns for each of some numbers, as it comes in."""
        default, use_x64 = default_device(), jax.config.read("jax_enable_x64")
        devices = [default] if isinstance(default, jax.Device) else jax.local_devices(backend=default)[: self.devices]
        workers = self.workers or max(len(devices), 3 * n_usable_cores() // 2 if devices[0].platform == "cpu" else 1)
        free_devices: SimpleQueue = SimpleQueue()
        for device in islice(cycle(devices), workers):
            free_devices.put(device if len(devices) > 1 else default)

        def on_device(number):
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
    """In place of a pool of threads: what holds in this thread alone, as the precision that is asked for, holds."""

    map = staticmethod(map)


def run_in_flight(submit, numbers, max_in_flight):
    """The results of begin(number), a future each, as they come in, so many at a time; the first error cancels the
    rest."""
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
    """That of `jax.default_device`, or the name of its kind; None where jax may choose."""
    return jax.config.jax_default_device


def n_usable_cores():
    """How many of the machine's cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
