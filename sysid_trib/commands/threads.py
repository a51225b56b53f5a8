"""How many threads compute in a command."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra in one thread, and after it in as many as before.

    Tables are tall and narrow: threads of BLAS wait for each other longer than they compute, a third of the
    time of a long record.
    """
    # Only libraries that are loaded can be told: that of numpy, and one of scipy's own.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
