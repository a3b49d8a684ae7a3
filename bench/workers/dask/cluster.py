"""The scheduler that a sweep uses: one of its own on this machine, or the one at an address. The terminal stays clean.

Whatever goes wrong with it is one line, a `ClusterError`. Finished runs are kept then: the same command goes on.
"""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    from calibench.bench.workers.dask.local import LocalWorkers

_LOGGERS = ("distributed", "dask", "tornado", "asyncio")
_HOST = "127.0.0.1"


class ClusterError(ValueError):
    """A Dask cluster cannot be used, or not any longer."""


@final
class Cluster:
    """A scheduler with its workers, and our client of it. What it is called stands in `name`."""

    def __init__(self, client: Any, address: str | None, local: LocalWorkers | None) -> None:
        self.client = client
        self.name = f"execution.address={address}" if address else "execution=dask"
        self._local = local

    @property
    def is_local(self) -> bool:
        """Tell whether the workers are ours."""
        return self._local is not None

    def workers(self) -> dict[str, int]:
        """Return the workers there are, {address: threads}, those of ours refilled. Raises `ClusterError`."""
        try:
            if self._local is not None:
                self._local.refill()
            if self.client.status != "running":
                raise OSError("it hung up")
            return dict(self.client.nthreads())
        except (OSError, TimeoutError) as error:
            raise self.lost(error) from None

    def lost(self, error: BaseException) -> ClusterError:
        """Return the error of a scheduler that is there no longer."""
        words = " ".join(str(error).split()) or type(error).__name__
        return ClusterError(
            f"{self.name}: the scheduler was lost ({words}); finished runs are kept, the same command goes on"
        )


@contextmanager
def cluster(workers: int, address: str | None) -> Iterator[Cluster]:
    """Yield a cluster of `workers` processes of this machine, or the one whose scheduler is at `address`.

    Raises `ClusterError` where `distributed` is missing, or the scheduler cannot be reached.
    """
    distributed = _distributed()
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        local = None
        if address is not None:
            where = address
        else:
            from calibench.bench.workers.dask.local import LocalWorkers

            scratch = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="calibench-dask-", ignore_cleanup_errors=True)
            )
            scheduler = stack.enter_context(_own_scheduler(distributed))
            where = str(scheduler.scheduler_address)
            local = LocalWorkers(where, workers, scratch)
            stack.callback(local.close)
        client = _client(distributed, where)
        stack.callback(client.close, timeout=5)
        yield Cluster(client, address, local)


def check_cluster(address: str | None) -> None:
    """Raise `ClusterError` where `cluster` would, before anything is started; of an `address` it asks who is there."""
    distributed = _distributed()
    if address is not None:
        with _quiet():
            _client(distributed, address).close(timeout=5)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ClusterError("execution=dask: needs distributed; pip install 'calibench[dask]'") from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler at `address`. Raises `ClusterError` where none answers."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other versions of Dask; ours are compared one by one
            return distributed.Client(address, set_as_default=False)
    except Exception as error:  # a name that no host has, an unknown protocol, a port where something else answers
        words = " ".join(str(error).split()) or type(error).__name__
        raise ClusterError(f"execution.address={address}: no Dask scheduler answers there: {words}") from None


def _own_scheduler(distributed: Any) -> Any:
    """Return a scheduler in this process, without workers and without a page."""
    return distributed.LocalCluster(
        n_workers=0, threads_per_worker=1, processes=True, host=_HOST, silence_logs=False,
        dashboard_address=f"{_HOST}:0",  # at None it takes port 8787, and warns where that is taken
        scheduler_kwargs={"allowed_failures": 0, "dashboard": False},
    )  # fmt: skip


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the loggers of Dask off the terminal, also those that are made meanwhile."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    known = [one for one in list(logging.root.manager.loggerDict.values()) if isinstance(one, logging.Logger)]
    silenced = [one for one in known if one.name.partition(".")[0] in _LOGGERS and not one.disabled]
    handlers = [handler for logger in loggers for handler in logger.handlers]
    for logger in silenced:
        logger.disabled = True
    for handler in handlers:
        handler.addFilter(_nothing)
    try:
        yield
    finally:
        for logger in silenced:
            logger.disabled = False
        for handler in handlers:
            handler.removeFilter(_nothing)


def _nothing(record: logging.LogRecord) -> bool:
    return False
