"""Play episodes of a scene, in this process or on local workers, with the same results."""

from __future__ import annotations

import functools
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, TrocarError
from trocar.tasks.registry import make_task
from trocar.tasks.task import Episode, Task

Array = NDArray[np.float64]
#: Returns an action from an observation.
Policy = Callable[[dict[str, Array]], ArrayLike]
#: Returns the actions of an episode from its task, after the reset, one every 20 ms; to run on
#: workers, it can be pickled.
Script = Callable[[Task], Iterator[Array]]
Result = TypeVar("Result")

#: Time within which an own policy must return an action. Source: our own choice. [s]
PATIENCE_S = 10.0
#: Rounding errors of an episode's time are smaller. [s]
EARLY_S = 1e-6
#: Times that an episode is begun whose worker dies. Source: our own choice.
ATTEMPTS = 3


def scripted(task: Task) -> Iterator[Array]:
    """Return the actions of a task's own policy: the `Script` of each scene that has one."""
    return task.policy()


def run_episode(
    task: Task,
    seed: int,
    policy: Policy | None = None,
    *,
    script: Script = scripted,
    duration_s: float = float("inf"),
    watch: Callable[[float], None] = lambda _: None,
) -> Episode:
    """Run an episode to its end and return its result.

    Args:
        task: reset first
        seed: of the episode
        policy: returns an action from an observation; None: `script` drives
        script: returns the actions of the episode, after whose end the arms stay where they are
        duration_s: simulated time after which the episode is stopped, `reason` "running" [s]
        watch: called with the time of the episode after each action [s]

    Raises:
        InputError: no free place, no scripted policy, or an action that is not allowed
        DivergedError: the simulation diverged
    """
    seen = task.reset(seed)
    actions = script(task) if policy is None else iter(())
    while not task.done and task.time < duration_s - EARLY_S:
        if policy is None:
            action: ArrayLike | None = next(actions, None)
            action = task.stay() if action is None else action
        else:
            begin = time.perf_counter()
            action = policy(seen)
            if (taken := time.perf_counter() - begin) > PATIENCE_S:
                raise InputError(
                    f"{task.scene.name}: the policy took {taken:.1f} s for an action; allowed:"
                    f" {PATIENCE_S:g} s"
                )
        task.command(action)
        watch(task.time)
        if policy is not None:
            seen = task.observation()
    return task.result(seed)


def play(
    scene: Scene | str,
    seeds: Sequence[int],
    workers: int = 1,
    cluster: str = "",
    *,
    script: Script = scripted,
    duration_s: float = float("inf"),
    watch: Callable[[float], None] = lambda _: None,
) -> Iterator[Episode]:
    """Yield the episodes of seeds in their order, as each is known.

    Each follows from scene, seed and script alone, wherever it runs. The episode of a worker that
    dies is run again; no other is.

    Args:
        scene: a scene, its name, or the path of its file
        seeds: of the episodes
        workers: processes; 1: this one
        cluster: address of a Ray cluster that has trocar installed, "local" for one of `workers`
            processes on this machine; "" for none
        script: returns the actions of an episode
        duration_s: simulated time after which an episode is stopped [s]
        watch: called with the time of the episode that runs in this process [s]

    Raises:
        InputError: no such scene, workers below 1, no such cluster
        TrocarError: what an episode raised, or its worker died three times
    """
    if workers == 1 and not cluster:
        task = make_task(scene)
        for seed in seeds:
            yield run_episode(task, seed, script=script, duration_s=duration_s, watch=watch)
        return
    label = scene if isinstance(scene, str) else scene.name
    run = functools.partial(_episode, scene, script, duration_s=duration_s)
    yield from each_seed(run, seeds, label, workers, cluster)


def each_seed(
    run: Callable[[int], Result],
    seeds: Sequence[int],
    label: str,
    workers: int = 1,
    cluster: str = "",
) -> Iterator[Result]:
    """Yield the results of seeds in their order, computed in processes, as each is known.

    Args:
        run: returns the result of a seed; it and its results can be pickled
        seeds: of the episodes
        label: of error messages
        workers, cluster: as for `play`

    Raises:
        InputError: workers below 1, no such cluster
        TrocarError: what a run raised, or its worker died three times
    """
    if workers < 1:
        raise InputError(f"workers: got {workers}; allowed: 1 or more")
    if cluster:
        yield from _on_cluster(run, seeds, label, cluster, workers)
        return
    pool = _Pool(run, list(seeds), label, min(workers, len(seeds)))
    try:
        yield from pool.results()
    finally:
        pool.close()


def _on_cluster(
    run: Callable[[int], Result], seeds: Sequence[int], label: str, address: str, workers: int
) -> Iterator[Result]:
    """Yield the results of seeds, computed by a Ray cluster."""
    try:
        import ray as installed  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(
            "--cluster: needs Ray, which is not installed: pip install 'trocar[cluster]'"
        ) from None
    ray = cast(Any, installed)
    here: dict[str, Any] = {"num_cpus": workers, "include_dashboard": False}
    if address != "local":
        here = {"address": address}
    try:
        ray.init(log_to_driver=False, logging_level="ERROR", **here)
    except Exception as problem:  # noqa: BLE001  the very class that Ray raises when it starts late
        allowed = "HOST:PORT of a Ray cluster, or local"
        raise InputError(f"--cluster: got {address!r}: {problem}; allowed: {allowed}") from None
    try:
        remote = ray.remote(_run_shared).options(max_retries=ATTEMPTS - 1)
        shared = [ray.put(run)]  # Ray itself reads what stands in a list for no worker
        answers = [remote.remote(shared, seed) for seed in seeds]
        for seed, due in zip(seeds, answers, strict=True):
            try:
                yield ray.get(due)
            except ray.exceptions.RayTaskError as problem:
                raise TrocarError(str(problem.cause)) from None
            except ray.exceptions.RayError as problem:
                raise TrocarError(
                    f"{label}: seed {seed}: the worker died {ATTEMPTS} times: {problem}"
                ) from None
    finally:
        ray.shutdown()


def _episode(scene: Scene | str, script: Script, seed: int, duration_s: float) -> Episode:
    """Run an episode in a process that has perhaps run others of the scene before."""
    return run_episode(_task(scene), seed, script=script, duration_s=duration_s)


_task = functools.cache(make_task)


def _run_shared(shared: list[Any], seed: int) -> object:
    """Run a seed in a worker of Ray, which reads the shared function once for all its seeds."""
    return _read_shared(shared[0])(seed)


@functools.lru_cache(maxsize=1)
def _read_shared(reference: Any) -> Callable[[int], object]:
    import ray  # pyright: ignore[reportMissingImports]

    return cast(Any, ray).get(reference)


@dataclass
class _Worker:
    process: BaseProcess
    connection: Connection[Any, Any]
    index: int | None = None


@dataclass
class _Pool(Generic[Result]):
    """Processes that each run one episode at a time."""

    run: Callable[[int], Result]
    seeds: list[int]
    label: str
    count: int
    workers: list[_Worker] = field(default_factory=list[_Worker])

    def results(self) -> Iterator[Result]:
        """Yield the results in the order of the seeds."""
        waiting = list(range(len(self.seeds)))[::-1]
        begun = [0] * len(self.seeds)
        found: dict[int, Result] = {}
        due = 0
        while due < len(self.seeds):
            self._assign(waiting, begun)
            busy = [worker for worker in self.workers if worker.index is not None]
            ready = wait([worker.connection for worker in busy])
            for worker in busy:
                if worker.connection in ready:
                    self._receive(worker, waiting, begun, found)
            while due in found:
                yield found.pop(due)
                due += 1

    def close(self) -> None:
        """End the processes."""
        for worker in self.workers:
            worker.connection.close()
            worker.process.terminate()
            worker.process.join()

    def _assign(self, waiting: list[int], begun: list[int]) -> None:
        """Give every idle worker an episode; start workers that are missing."""
        while waiting and (idle := self._idle()) is not None:
            idle.index = waiting.pop()
            begun[idle.index] += 1
            with suppress(OSError):  # it died; `wait` reports the end of its pipe
                idle.connection.send(self.seeds[idle.index])

    def _idle(self) -> _Worker | None:
        for worker in self.workers:
            if worker.index is None:
                return worker
        if len(self.workers) == self.count:
            return None
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(self.run, there), daemon=True)
        process.start()
        there.close()
        self.workers.append(_Worker(process, here))
        return self.workers[-1]

    def _receive(
        self, worker: _Worker, waiting: list[int], begun: list[int], found: dict[int, Result]
    ) -> None:
        """Take a worker's result; replace a worker that died and run its episode again."""
        index = worker.index or 0
        try:
            answer = worker.connection.recv()
        except (EOFError, OSError):
            self.workers.remove(worker)
            worker.connection.close()
            worker.process.join()
            if begun[index] == ATTEMPTS:
                raise TrocarError(
                    f"{self.label}: seed {self.seeds[index]}: the worker died {ATTEMPTS} times, the"
                    f" last time with exit code {worker.process.exitcode}"
                ) from None
            waiting.append(index)
            return
        if isinstance(answer, TrocarError):
            raise answer
        worker.index = None
        found[index] = answer


def _work(run: Callable[[int], object], connection: Connection[Any, Any]) -> None:
    """Run episodes as their seeds arrive, in a process of its own."""
    try:
        while True:
            connection.send(run(connection.recv()))
    except (EOFError, KeyboardInterrupt):
        return
    except TrocarError as problem:
        connection.send(TrocarError(str(problem)))
