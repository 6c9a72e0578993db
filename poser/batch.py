"""Many recordings: one after another, in several processes, or on a cluster's workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from mocap.errors import PoserError
from poser.comparison import Job, attempt
from poser.console import Progress, part
from poser.report.results import Compared, Lost


def run_many(
    jobs: Sequence[Job],
    processes: int = 1,
    tell: Progress = lambda fraction, words: None,
    cluster: str | None = None,
    keep: Callable[[Compared], None] = lambda compared: None,
    done: Callable[[str, str], None] = lambda recording, method: None,
) -> list[Compared | Lost]:
    """What came of all jobs, in their order; several at a time where asked, each in a process of its own.

    cluster: address of a Dask scheduler whose workers do them (the extra `cluster`). keep: called with each
    result as it comes, so that an interruption loses none that is done. done: with the names of each
    recording and method that has been measured; those of another process come with its recording.
    """
    found: dict[int, Compared | Lost] = {}

    def came(i: int, result: Compared | Lost) -> None:
        found[i] = result
        if isinstance(result, Compared):
            keep(result)

    def came_from_afar(i: int, result: Compared | Lost) -> None:
        for method in jobs[i].methods:
            if isinstance(result, Compared) and method in result.methods:
                done(result.name, method)
        came(i, result)

    if cluster is not None:
        _on_cluster(jobs, cluster, tell, came_from_afar)
    elif processes <= 1 or len(jobs) <= 1:
        for i, job in enumerate(jobs):
            words = f"{job.name} ({i + 1} of {len(jobs)})" if len(jobs) > 1 else ""
            share = part(tell, i / len(jobs), (i + 1) / len(jobs), words)
            came(i, attempt(job, share, partial(done, job.name)))
    else:
        _in_processes(jobs, processes, tell, came_from_afar)
    return [found[i] for i in range(len(jobs))]


def _in_processes(
    jobs: Sequence[Job],
    processes: int,
    tell: Progress,
    came: Callable[[int, Compared | Lost], None],
) -> None:
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    # Spawned, not forked: torch and OpenMP do not survive a fork of a process that has used them.
    with ProcessPoolExecutor(
        min(processes, len(jobs)), mp_context=get_context("spawn"), initializer=_one_thread
    ) as pool:
        futures = {pool.submit(attempt, job): i for i, job in enumerate(jobs)}
        try:
            for count, future in enumerate(as_completed(futures), 1):
                i = futures[future]
                came(i, future.result())
                tell(count / len(jobs), f"{jobs[i].name}: done, {count} of {len(jobs)}")
        except BaseException as e:
            running = list((pool._processes or {}).values())  # shutdown forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            if isinstance(e, BrokenProcessPool):
                raise PoserError(
                    "a worker process was killed, perhaps for want of memory; try fewer --jobs"
                ) from e
            raise


def _one_thread() -> None:
    """A worker uses one core: the processes are the parallelism. Ctrl-C is the parent's to handle."""
    import os
    import signal
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def _end_with_parent() -> None:
    """End this process when its parent does, however that ends."""
    import os
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _on_cluster(
    jobs: Sequence[Job], address: str, tell: Progress, came: Callable[[int, Compared | Lost], None]
) -> None:
    try:
        from dask.distributed import Client, as_completed
    except ImportError as e:
        raise PoserError(
            "--cluster needs dask.distributed: pip install 'poser-imu[cluster]'"
        ) from e
    with Client(address, timeout=30) as client:
        futures = [client.submit(attempt, job, pure=False) for job in jobs]
        place = {f.key: i for i, f in enumerate(futures)}
        for count, (future, result) in enumerate(as_completed(futures, with_results=True), 1):
            came(place[future.key], result)
            tell(count / len(jobs), f"{count} of {len(jobs)} recordings")
