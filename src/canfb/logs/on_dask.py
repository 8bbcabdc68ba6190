"""Logs on Dask, on processes of this machine or on a cluster: the one place that knows it."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Any, Self

from canfb.errors import CanfbError, ConfigError, reason
from canfb.logs.log_replay import ReplayOptions
from canfb.logs.log_rows import LogJob, Row, failed_rows, rows_of

HINT = "Dask is not there: pip install 'canfb[fleet]'; or --scheduler none, in this process alone"
LOCAL = "local"
CONNECT_S = 10
RETRIES = 3  # of a log whose process was killed


class DaskPool:
    """A context manager around :meth:`run`.

    ``scheduler`` is "local", for ``workers`` processes of this machine (None: one per CPU), each started
    again if it is killed, or the address of a scheduler, whose workers must see the logs under the same
    names. CanfbError without Dask, and for a scheduler that does not answer.
    """

    def __init__(self, scheduler: str = LOCAL, workers: int | None = None) -> None:
        if scheduler != LOCAL and workers is not None:
            raise ConfigError("--workers: a cluster has its own")
        if workers is not None and workers < 1:
            raise ConfigError(f"--workers {workers}: must be 1 at least")
        self._scheduler, self._workers = scheduler, workers
        self._opened = contextlib.ExitStack()
        self.client: Any = None
        self.cluster: Any = None

    def __enter__(self) -> Self:
        try:
            import distributed as installed
        except ImportError as error:
            raise CanfbError(HINT) from error
        distributed: Any = installed
        self._distributed: Any = distributed
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a log that fails has its row
        with contextlib.ExitStack() as opened:
            if self._scheduler == LOCAL:
                self.cluster = opened.enter_context(
                    distributed.LocalCluster(
                        n_workers=self._workers,
                        threads_per_worker=1,
                        processes=True,
                        scheduler_kwargs={"dashboard": False},
                        silence_logs=logging.CRITICAL,
                    )
                )
            try:
                client = distributed.Client(self.cluster or self._scheduler, timeout=CONNECT_S)
            except (OSError, ValueError, TimeoutError) as error:
                raise CanfbError(
                    f"--scheduler {self._scheduler}: does not answer: {reason(error)}"
                ) from error
            self.client = opened.enter_context(client)
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
        """Each log with its rows, as they are done.

        A log whose process is killed is done again, a few times. The largest come first: the end is not
        spent waiting for one of them.
        """
        ordered = sorted(jobs, key=lambda job: -job.size)
        shared = self.client.scatter(settings, broadcast=True)
        futures = {
            self.client.submit(rows_of, job, shared, pure=False, retries=RETRIES): job for job in ordered
        }
        for future in self._distributed.as_completed(list(futures)):
            job = futures.pop(future)
            error = future.exception()
            if error is None:
                yield job, future.result()
            else:
                why = f"{type(error).__name__}: its process was ended again and again"
                yield job, failed_rows(job, settings, why)
            future.release()
