"""Chunks worked out by a Dask cluster, one that is there or one of this machine's own; workers may come and go."""

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
CHUNKS_PER_THREAD = 2  # chunks of a worker's thread that are handed out before the first is back
MAX_WORKER_LOSSES = 5  # times that a chunk's workers may be lost, each as many of them as the cluster allows
MIN_IN_FLIGHT = 64  # chunks that are handed out while no worker is known
CONNECT_TIMEOUT, STARTUP_TIMEOUT = (
    30.0,
    600.0,
)  # seconds for a scheduler to answer, and beside workers of its own that all load
# A worker that waits takes 0.5 % of a core with these: what it samples and counts, which nobody sees, took 6. One that
# takes a lost one's place is waited for: it may load for long, and was given up after 15 s.
DASK_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.deploy.lost-worker-timeout": f"{STARTUP_TIMEOUT} s",
}
SHARED_JAX_SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)  # settings that workers share


@dataclass(frozen=True)
class DaskEngine:
    """Works chunks out on a Dask cluster, whose workers can reach the store's folder by the same path.

    address: of a scheduler, as "tcp://host:8786"; None: a cluster of this machine is started, and stopped at the end.
    workers: processes of that, None for one a core that may be used. Workers may be lost and new ones come: a chunk
    whose worker was lost is handed out again. What is sent to them is pickled, as Dask does: trust the cluster.

    A script that starts a cluster of its own does so below `if __name__ == "__main__":`. Needs
    `pip install jaxvibro[cluster]`. Raises ArgumentError for numbers that cannot be; OSError where no scheduler
    answers, where it is lost, and where a chunk ends each worker that it is given to.
    """

    address: str | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        if self.address is not None and not (isinstance(self.address, str) and self.address):
            raise check.ArgumentError("address", 'must be of a scheduler, as "tcp://host:8786", or None', self.address)
        if self.workers is not None:
            check.whole_number("workers", self.workers, 1)
            if self.address is not None:
                raise check.ArgumentError("workers", "must not be given for a cluster that is there", self.workers)

    def each(self, work: Callable[[int], Result], numbers: Iterable[int]) -> Iterator[Result]:
        """What work(number) returns for each of some numbers, as it comes in."""
        payload = cloudpickle.dumps(work), jax.config.read("jax_enable_x64")
        pending_numbers, worker_losses = iter(numbers), Counter[int]()
        with ExitStack() as stack:
            client = self._connect(stack)
            futures, number_of_key = as_completed(loop=client.loop), dict[str, int]()

            def submit_chunks(chunk_numbers):
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
                            raise OSError(f"chunk {number} has ended each worker that it was given to") from None
                        submit_chunks([number])
                    except (CancelledError, CommClosedError):
                        address = client.scheduler.address if client.scheduler else self.address
                        message = f"the scheduler at {address} is lost; what is done is kept: run it again"
                        raise OSError(message) from None
                submit_chunks(islice(pending_numbers, max(0, _max_in_flight(client) - len(number_of_key))))

    def _connect(self, stack):
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
    """What futures that have ended return, asked for at one go; None where one has failed."""
    try:
        return client.gather(futures)
    except Exception:  # each tells its own when it is asked
        return None


def _max_in_flight(client):
    """Chunks that are handed out at a time."""
    return max(MIN_IN_FLIGHT, CHUNKS_PER_THREAD * sum(client.nthreads().values()))


def _compute_chunk(pickled_work, use_x64, number):
    """Runs on a worker, whose numbers are of another precision where it was not told: those that are sent, too."""
    with jax.enable_x64(use_x64):
        return _unpickle(pickled_work, use_x64)(number)


@lru_cache(4)
def _unpickle(pickled_work, use_x64):
    return cloudpickle.loads(pickled_work)
