"""Compute chunks on a Dask cluster, which may be started on this machine; workers may join and leave."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from logging import CRITICAL
from typing import TypeVar

import cloudpickle
import jax
from dask import config
from distributed import CancelledError, Client, KilledWorker, LocalCluster, as_completed
from distributed.comm import CommClosedError

from ..scene import check
from .engines import n_usable_cores

Result = TypeVar("Result")
CHUNKS_PER_THREAD = 2  # chunks submitted for each thread of a worker
MAX_WORKER_LOSSES = 5  # times that the cluster may give up a chunk because its workers were lost
MIN_IN_FLIGHT = 64  # chunks submitted while no worker is known
CONNECT_TIMEOUT, STARTUP_TIMEOUT = (
    30.0,
    600.0,
)  # timeout of a scheduler, s; longer for one whose workers are starting on this machine
# An idle worker takes 0.5 % of a core with these settings, and 6 % with the default profiling and monitoring. The
# replacement of a lost worker may take long to start; the default timeout is 15 s.
DASK_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.deploy.lost-worker-timeout": f"{STARTUP_TIMEOUT} s",
}
SHARED_JAX_SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)  # settings passed to the workers


@dataclass(frozen=True)
class DaskEngine:
    """Execution engine that computes chunks on a Dask cluster.

    All workers must be able to access the folder of the store under the same path. A chunk whose worker was lost is
    submitted again.

    Parameters
    ----------
    address : str, optional
        Address of a scheduler, for example ``"tcp://host:8786"``. None starts a cluster on this machine and stops it
        at the end of the computation.
    workers : int, optional
        Number of processes of the cluster on this machine. None starts one process per usable core.

    Raises
    ------
    ArgumentError
        If an argument is invalid.
    OSError
        During a computation, if no scheduler answers, if the scheduler is lost, or if a chunk repeatedly ends its
        worker.

    See Also
    --------
    LocalEngine : Engine that computes chunks with threads of this process.

    Notes
    -----
    The engine needs ``pip install jaxvibro[cluster]``. A script that starts a cluster must do so below
    ``if __name__ == "__main__":``. Data for the workers are pickled, as in Dask. Use only a cluster that you trust.

    Examples
    --------
    >>> store = jv.Store("map.zarr", jv.DaskEngine(workers=2))
    >>> store.engine
    DaskEngine(address=None, workers=2)
    """

    address: str | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        if self.address is not None and not (isinstance(self.address, str) and self.address):
            raise check.ArgumentError(
                "address", 'must be the address of a scheduler, for example "tcp://host:8786", or None', self.address
            )
        if self.workers is not None:
            check.check_whole_number("workers", self.workers, 1)
            if self.address is not None:
                raise check.ArgumentError("workers", "must be None if the address of a cluster is given", self.workers)

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
        work_and_precision = cloudpickle.dumps(work), jax.config.read("jax_enable_x64")
        pending_numbers, losses_per_chunk = iter(numbers), Counter[int]()
        with ExitStack() as exit_stack:
            client = self._connect(exit_stack)
            futures, chunk_by_future_key = as_completed(loop=client.loop), dict[str, int]()

            def submit_chunks(chunk_numbers):
                """Submit some chunks to the cluster."""
                for chunk_number in chunk_numbers:
                    future = client.submit(_compute_chunk, *work_and_precision, chunk_number, pure=False)
                    chunk_by_future_key[future.key] = chunk_number
                    futures.add(future)

            submit_chunks(islice(pending_numbers, _max_chunks_in_flight(client)))
            for future_batch in futures.batches():
                batch_results = _gather_results(client, future_batch)
                for index, future in enumerate(future_batch):
                    chunk_number = chunk_by_future_key.pop(future.key)
                    try:
                        yield future.result() if batch_results is None else batch_results[index]
                    except KilledWorker:
                        losses_per_chunk[chunk_number] += 1
                        if losses_per_chunk[chunk_number] == MAX_WORKER_LOSSES:
                            raise OSError(f"chunk {chunk_number} has ended every worker that computed it") from None
                        submit_chunks([chunk_number])
                    except (CancelledError, CommClosedError):
                        scheduler_address = client.scheduler.address if client.scheduler else self.address
                        error_message = (
                            f"the scheduler at {scheduler_address} is lost; finished chunks are"
                            " stored: run the study again"
                        )
                        raise OSError(error_message) from None
                submit_chunks(islice(pending_numbers, max(0, _max_chunks_in_flight(client) - len(chunk_by_future_key))))

    def _connect(self, exit_stack):
        """Return a client of the scheduler; without an address, start a cluster on this machine."""
        scheduler_address, connect_timeout = self.address, CONNECT_TIMEOUT
        if scheduler_address is None:
            worker_environment = {
                setting_name.upper(): str(setting_value)
                for setting_name in SHARED_JAX_SETTINGS
                if (setting_value := getattr(jax.config, setting_name)) is not None
            }
            cluster_size_options = {
                "n_workers": self.workers or n_usable_cores(),
                "threads_per_worker": 1,
                "memory_limit": 0,
            }
            logging_options = {"dashboard_address": None, "silence_logs": CRITICAL}
            exit_stack.enter_context(config.set(DASK_SETTINGS))
            scheduler_address = exit_stack.enter_context(
                LocalCluster(**cluster_size_options, **logging_options, processes=True, env=worker_environment)
            )
            connect_timeout = STARTUP_TIMEOUT
        try:
            return exit_stack.enter_context(Client(scheduler_address, timeout=connect_timeout, set_as_default=False))
        except (OSError, ValueError) as error:
            raise OSError(f"no scheduler answers at {scheduler_address}: {check.shorten_text(error)}") from None


def _gather_results(client, futures):
    """Return the results of completed futures in one request; None if any future has failed."""
    try:
        return client.gather(futures)
    except Exception:  # each failed future raises its own error later
        return None


def _max_chunks_in_flight(client):
    """Return the maximum number of chunks that are submitted and not yet completed."""
    return max(MIN_IN_FLIGHT, CHUNKS_PER_THREAD * sum(client.nthreads().values()))


def _compute_chunk(pickled_work, use_x64, chunk_number):
    """Compute a chunk on a worker, in the precision of the caller.

    The function is also unpickled in this precision, because it may contain arrays.
    """
    with jax.enable_x64(use_x64):
        return _unpickle_work(pickled_work, use_x64)(chunk_number)


@lru_cache(4)
def _unpickle_work(pickled_work, use_x64):
    return cloudpickle.loads(pickled_work)
