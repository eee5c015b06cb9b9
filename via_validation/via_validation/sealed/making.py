"""Draw and seal many cases in parallel processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from via_validation.sealed.case import draw_case
from via_validation.sealed.sealing import SealError, name_of, seal, write_seals

MAX_CASES = 1000


@dataclass(frozen=True)
class Made:
    name: str
    digest: str
    attempts: int


def make_cases(
    seeds: Sequence[int], cases: Path, keys: Path, duration: float, processes: int, progress: Callable[[Made], None]
) -> list[Made]:
    """Write the cases of `seeds`, numbered in order, into two folders; `progress` is called after each.

    After an interruption, finished cases can be used. Raises SealError if one folder contains the other, or if
    a case exists already.
    """
    first, second = cases.resolve(), keys.resolve()
    if first == second or first in second.parents or second in first.parents:
        raise SealError(f"keys in {keys} and cases in {cases}: neither folder may hold the other")
    if not 1 <= len(seeds) <= MAX_CASES:
        raise SealError(f"the number of cases must be 1 to {MAX_CASES}, got {len(seeds)}")
    cases.mkdir(parents=True, exist_ok=True)
    keys.mkdir(parents=True, exist_ok=True)
    work = partial(_made, cases=cases, keys=keys, duration=duration)
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(work, number, seed) for number, seed in enumerate(seeds)]
        try:
            for job in as_completed(jobs):
                progress(job.result())
        finally:  # an interrupted command leaves cases that can be used
            pool.shutdown(wait=True, cancel_futures=True)
            whole = [job for job in jobs if not job.cancelled() and job.exception() is None]
            done = sorted((job.result() for job in whole), key=lambda each: each.name)
            write_seals(cases, {each.name: each.digest for each in done})
    return done


def _made(number: int, seed: int, cases: Path, keys: Path, duration: float) -> Made:
    case, name = draw_case(seed, duration), name_of(number)
    return Made(name, seal(case, name, cases, keys), case.attempts)
