"""Execution engine on a Dask cluster, existing or started on this machine; workers may join and leave."""

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

    The workers must reach the folder of the store by the same path. A chunk whose worker was lost is submitted again.

    Parameters
    ----------
    address : str, optional
        Address of a scheduler, for example ``"tcp://host:8786"``. None starts a cluster on this machine, which is
        stopped at the end.
    workers : int, optional
        Number of processes of that cluster. None takes one for each usable core.

    Raises
    ------
    ArgumentError
        If an argument is invalid.
    OSError
        During a computation, if no scheduler answers, the scheduler is lost, or a chunk ends every worker that computes
        it.

    See Also
    --------
    LocalEngine : Engine that computes chunks with threads of this process.

    Notes
    -----
    Needs ``pip install jaxvibro[cluster]``. A script that starts a cluster of its own must do so below
    ``if __name__ == "__main__":``. Data sent to the workers are pickled, as in Dask: use a cluster that you trust.

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
            check.whole_number("workers", self.workers, 1)
            if self.address is not None:
                raise check.ArgumentError("workers", "must be None if the address of a cluster is given", self.workers)

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
        payload = cloudpickle.dumps(work), jax.config.read("jax_enable_x64")
        pending_numbers, worker_losses = iter(numbers), Counter[int]()
        with ExitStack() as stack:
            client = self._connect(stack)
            futures, number_of_key = as_completed(loop=client.loop), dict[str, int]()

            def submit_chunks(chunk_numbers):
                """Submit chunks to the cluster."""
                for number in chunk_numbers:
                    future = client.submit(_compute_chunk, *payload, number, pure=False)
                    number_of_key[future.key] = number
                    futures.add(future)

            submit_chunks(islice(pending_numbers, _max_in_flight(client)))
            for batch in futures.batches():
                results = _gather_results(client, batch)
                for index, future in enumerate(batch):
                    number = number_of_key.pop(future.key)
                    try:
                        yield future.result() if results is None else results[index]
                    except KilledWorker:
                        worker_losses[number] += 1
                        if worker_losses[number] == MAX_WORKER_LOSSES:
                            raise OSError(f"chunk {number} has ended every worker that computed it") from None
                        submit_chunks([number])
                    except (CancelledError, CommClosedError):
                        address = client.scheduler.address if client.scheduler else self.address
                        message = f"the scheduler at {address} is lost; finished chunks are stored: run the study again"
                        raise OSError(message) from None
                submit_chunks(islice(pending_numbers, max(0, _max_in_flight(client) - len(number_of_key))))

    def _connect(self, stack):
        """Return a client of the scheduler, with a cluster of this machine if there is no address."""
        address, timeout = self.address, CONNECT_TIMEOUT
        if address is None:
            environment = {
                name.upper(): str(value)
                for name in SHARED_JAX_SETTINGS
                if (value := getattr(jax.config, name)) is not None
            }
            cluster_size = {"n_workers": self.workers or n_usable_cores(), "threads_per_worker": 1, "memory_limit": 0}
            quiet_options = {"dashboard_address": None, "silence_logs": CRITICAL}
            stack.enter_context(config.set(DASK_SETTINGS))
            address = stack.enter_context(
                LocalCluster(**cluster_size, **quiet_options, processes=True, env=environment)
            )
            timeout = STARTUP_TIMEOUT
        try:
            return stack.enter_context(Client(address, timeout=timeout, set_as_default=False))
        except (OSError, ValueError) as error:
            raise OSError(f"no scheduler answers at {address}: {check.shorten(error)}") from None


def _gather_results(client, futures):
    """Return the results of completed futures in one request; None if one has failed."""
    try:
        return client.gather(futures)
    except Exception:  # each failed future raises its own error later
        return None


def _max_in_flight(client):
    """Return the number of chunks that are submitted at the same time."""
    return max(MIN_IN_FLIGHT, CHUNKS_PER_THREAD * sum(client.nthreads().values()))


def _compute_chunk(pickled_work, use_x64, number):
    """Compute a chunk on a worker, in the precision of the caller; unpickled arrays need it too."""
    with jax.enable_x64(use_x64):
        return _unpickle(pickled_work, use_x64)(number)


@lru_cache(4)
def _unpickle(pickled_work, use_x64):
    return cloudpickle.loads(pickled_work)
