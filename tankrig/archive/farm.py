"""Workers of Dask that refit an archive: a cluster on this machine that nobody else reaches, or a scheduler elsewhere.

Dask's scheduler runs what it is told by whoever reaches it. The cluster made here listens on 127.0.0.1 only, has no
dashboard, and asks for certificates that are made for it and die with it; a scheduler elsewhere must ask for such too.
"""

import asyncio
import itertools
import logging
import os
import statistics
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from tankrig.archive.refit import RunToRefit
from tankrig.archive.task import FAILED, MADE, Done, OtherCodeError
from tankrig.errors import StoreError, TankrigError
from tankrig.light.prepared.cache import cache_folder

if TYPE_CHECKING:
    from distributed import Client, Security

AHEAD = 3
"""Errands under way for each thread of a worker: none has to wait, and a hundred thousand are never held at once."""
PACK_S = 1.0
"""Of work that is sent at once."""
MOST_IN_PACK = 32
LEAST_TOLD = 5
"""Runs after which it is known about how long one takes."""
LOST_AT_MOST = 20
"""So many workers may die while they have a run; then the run is a failure. A worker dies with at most two in hand, and
most deaths are not the run's fault."""
AT_HOME = ("127.0.0.1", "localhost", "::1")
NEEDED = 'pip install "tankrig[cluster]"'


class SchedulerError(TankrigError, RuntimeError):
    """A scheduler that cannot be reached, or has gone away."""


class UnprotectedError(TankrigError, ValueError):
    """A scheduler elsewhere that asks nobody who they are."""


@dataclass(frozen=True)
class Certificates:
    """Files, PEM, by which the two ends of a line know each other.

    Parameters
    ----------
    authority, certificate, key
        Of who signs for all, of this program, and its secret key.
    """

    authority: Path
    certificate: Path
    key: Path

    def security(self) -> "Security":
        """As Dask takes them.

        Raises
        ------
        StoreError
            When one of the files is not there.
        """
        from distributed import Security

        for file in (self.authority, self.certificate, self.key):
            if not file.is_file():
                raise StoreError(f"{file}: is not there; give the file that the scheduler's certificates came with")
        files = {f"tls_{who}_{what}": str(file) for who in ("client", "worker", "scheduler")
                 for what, file in (("cert", self.certificate), ("key", self.key))}  # fmt: skip
        return Security(require_encryption=True, tls_ca_file=str(self.authority), **files)


def require_dask() -> None:
    """Refuse to go on without Dask's scheduler.

    Raises
    ------
    TankrigError
        When it is not installed.
    """
    from importlib.util import find_spec

    if find_spec("distributed") is None:
        raise TankrigError(f"workers beside this process need Dask's scheduler, which is not installed: {NEEDED}")


@contextmanager
def workers_here(
    count: int, threads: int = 1, limit_s: float | None = None, memory: str | None = None
) -> "Iterator[Client]":
    """Workers on this machine, each a process of its own; one that dies is replaced.

    Parameters
    ----------
    count
        How many.
    threads
        Of each, for sums within a run; a worker fits one run at a time.
    limit_s
        That each of them may live: it is then replaced, after its run.
    memory
        That each of them may take, such as "2GiB", beyond which it is replaced; None: an even share of the machine's.
    """
    from distributed import Client, LocalCluster, Security

    life = {} if limit_s is None else {
        "lifetime": f"{limit_s:g} s", "lifetime_stagger": f"{limit_s / 10.0:g} s", "lifetime_restart": True,
    }  # fmt: skip
    with _settings(), _environment(threads):
        _fork_ready_ones()
        with (
            LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, host="127.0.0.1", protocol="tls://",
                security=Security.temporary(), dashboard_address=None, worker_dashboard_address="127.0.0.1:0",
                memory_limit=memory or "auto", silence_logs=logging.CRITICAL,
                # What workers are forked from may be older than what the environment says now.
                env={"TANKRIG_CACHE": str(cache_folder())}, **life,
            ) as cluster,
            Client(cluster) as client,
        ):  # fmt: skip
            cluster.scheduler.http_server.stop()
            yield client


@contextmanager
def workers_elsewhere(address: str, certificates: Certificates | None) -> "Iterator[Client]":
    """The workers of a scheduler that runs already.

    Parameters
    ----------
    address
        Such as "tls://node7:8786".
    certificates
        That it asks for; None only for a scheduler on this machine.

    Raises
    ------
    SchedulerError
        When it cannot be reached.
    UnprotectedError
        When it is elsewhere and asks for no certificates.
    """
    from distributed import Client

    require_private(address, certificates)
    security = certificates.security() if certificates else None
    with _settings():
        try:
            client = Client(address, security=security, timeout=10.0, set_as_default=False)
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise SchedulerError(
                f"{address}: the scheduler does not answer ({_first_line(error)}); see that it runs, that its address "
                "is right, and that its certificates are those given"
            ) from error
        with client:
            yield client


def require_private(address: str, certificates: Certificates | None) -> None:
    """Refuse a line that others can listen to, or speak on.

    Raises
    ------
    UnprotectedError
        When a scheduler elsewhere is to be spoken to without certificates.

    Examples
    --------
    >>> require_private("tcp://127.0.0.1:8786", None)
    >>> require_private("tcp://node7:8786", None)
    Traceback (most recent call last):
    ...
    tankrig.archive.farm.UnprotectedError: tcp://node7:8786: whoever reaches a scheduler runs code on its workers, so \
one on another machine has to ask for certificates; start it with them, and give tls://… and --tls
    """
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme == "tls" and certificates is None:
        raise UnprotectedError(f"{address}: a tls:// address needs certificates; give --tls CA CERT KEY")
    if parts.hostname in AT_HOME or parts.scheme == "tls":
        return
    raise UnprotectedError(
        f"{address}: whoever reaches a scheduler runs code on its workers, so one on another machine has to ask for "
        "certificates; start it with them, and give tls://… and --tls"
    )


def by_workers(client: "Client", wanted: Sequence[RunToRefit]) -> Iterator[Done]:
    """Refit all these runs, a few at a time for each worker, in whatever order they end.

    Runs that are fitted in less than `PACK_S` are sent in packs, since sending costs 8 ms of this process each time.
    Each run of a pack is kept as soon as it is fitted, so that a worker that dies still loses one at most.

    Raises
    ------
    SchedulerError
        When the scheduler goes away.
    OtherCodeError
        When a worker runs other code.
    """
    from distributed import as_completed

    waiting, pace = deque(wanted), Pace()
    by_key: dict[str, tuple[RunToRefit, ...]] = {}
    count = itertools.count()

    def sent(pack: tuple[RunToRefit, ...]) -> Any:
        key = f"refit-{pack[0].name}-{next(count)}-{os.getpid()}"
        by_key[key] = pack
        return client.submit(_run, pack, pure=False, key=key)

    def next_pack() -> tuple[RunToRefit, ...]:
        size = min(pace.pack, -(-len(waiting) // _room(client)))  # the last ones are for all workers
        return tuple(waiting.popleft() for _ in range(size))

    try:
        first = [next_pack() for _ in range(_room(client)) if waiting]
        under_way = as_completed([sent(one) for one in first], loop=client.loop)
        for future in under_way:
            pack = by_key.pop(future.key)
            found = _outcomes(client, future, pack)
            future.release()
            if found is None:
                for one in pack:
                    under_way.add(sent((one,)))
                continue
            for done in found:
                pace.add(done)
                yield done
            while waiting and under_way.count() < _room(client):
                under_way.add(sent(next_pack()))
    except SchedulerError:
        raise
    except (OSError, TimeoutError, CancelledError, asyncio.CancelledError, RuntimeError) as error:
        raise SchedulerError(
            f"the scheduler has gone away ({_first_line(error)}); what was fitted is kept: start it again, and give "
            "the same command"
        ) from error


class Pace:
    """How many runs are sent at once, from what the latest of them took.

    Examples
    --------
    >>> pace = Pace()
    >>> for _ in range(9):
    ...     pace.add(Done("a run", "made", cpu_s=0.1))
    >>> pace.pack
    10
    """

    def __init__(self) -> None:
        self._latest_s: deque[float] = deque(maxlen=50)

    def add(self, done: Done) -> None:
        """Take in what a run took; one that was there, or failed, tells nothing of the others."""
        if done.outcome == MADE:
            self._latest_s.append(max(done.cpu_s, PACK_S / MOST_IN_PACK))

    @property
    def pack(self) -> int:
        """Runs that take `PACK_S` together; one where nothing tells yet."""
        if len(self._latest_s) < LEAST_TOLD:
            return 1
        return max(1, int(PACK_S / statistics.fmean(self._latest_s)))


def _run(pack: tuple[RunToRefit, ...]) -> list[Done]:
    return [one.run() for one in pack]


def _room(client: "Client") -> int:
    threads = int(sum(client.nthreads().values()))
    return AHEAD * max(threads, 2)


def _outcomes(client: "Client", future: Any, pack: tuple[RunToRefit, ...]) -> list[Done] | None:
    """What became of a pack; None where workers died with it or an error ended it, and each is tried alone."""
    from distributed import KilledWorker

    try:
        done: list[Done] = future.result()
        return done
    except OtherCodeError:
        raise
    except KilledWorker:
        if len(pack) > 1:
            return None
        return [Done(
            pack[0].name, FAILED,
            f"{pack[0].path}: {LOST_AT_MOST} workers died with it, so it may take more memory than they have; fit it "
            f"by itself: tankrig refit {pack[0].path}",
        )]  # fmt: skip
    except TankrigError as error:
        if client.status != "running":
            raise SchedulerError(f"the scheduler has gone away ({_first_line(error)})") from error
        return [Done(pack[0].name, FAILED, str(error))] if len(pack) == 1 else None


@contextmanager
def _settings() -> Iterator[None]:
    """Dask's settings that matter here, for as long as it is used; what goes wrong is told in our own words."""
    import dask
    import distributed  # noqa: F401  # which gives dask its settings

    for name in [one for one in logging.root.manager.loggerDict if one.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # several have a level of their own
    with dask.config.set({
        "distributed.scheduler.allowed-failures": LOST_AT_MOST,
        "distributed.scheduler.work-stealing": True,
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.comm.timeouts.connect": "10s",
        "distributed.worker.daemon": True,
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
        # A cluster gives up workers that were away for 15 s, which they are on a busy machine while they are replaced.
        "distributed.deploy.lost-worker-timeout": "1d",
        "distributed.worker.multiprocessing-method": "forkserver",
    }):  # fmt: skip
        yield


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """As many threads as a worker was given, in each of the libraries that take some; workers inherit it."""
    names = ("TANKRIG_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _fork_ready_ones() -> None:
    """Have workers forked from a process that has imported all they need."""
    import multiprocessing

    from distributed.utils import get_mp_context

    get_mp_context()  # once, it names all that it would import, more than is needed
    multiprocessing.set_forkserver_preload(["distributed", "tankrig.archive.ready"])


def _first_line(error: BaseException) -> str:
    with suppress(IndexError):
        return str(error).splitlines()[0]
    return type(error).__name__
