"""The stopwatch of all benchmarks; `time.process_time` does not count what else a busy machine does."""

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

Result = TypeVar("Result")
Clock = Callable[[], float]


def timed(call: Callable[[], Result], clock: Clock = time.perf_counter) -> tuple[Result, float]:
    """What a call returns, and its time, s."""
    begin = clock()
    result = call()
    return result, clock() - begin


def times(call: Callable[[], object], repeats: int, clock: Clock = time.perf_counter) -> np.ndarray:
    """Times of repeated calls, s; a first call, which compiles and imports, is not counted."""
    call()
    return np.array([timed(call, clock)[1] for _ in range(repeats)])


def median_ms(call: Callable[[], object], repeats: int, clock: Clock = time.perf_counter) -> float:
    """Median time of repeated calls, ms."""
    return 1e3 * float(np.median(times(call, repeats, clock)))
