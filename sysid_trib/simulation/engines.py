"""The engines of a simulation: heyoka where it is installed, scipy everywhere."""

from functools import cache
from importlib.util import find_spec

from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force
from sysid_trib.simulation.integrate import Engine


def engine_of(name: str, forces: tuple[Force, ...], tolerance: float) -> Engine:
    """The compiled motion under some forces by an engine, `heyoka` or `scipy` (of a relative tolerance).

    Raises
    ------
    UsageError
        There is no such engine.
    """
    if name == "scipy":
        from sysid_trib.simulation.engine_scipy import interpreted

        return interpreted(forces, tolerance)
    if name != "heyoka" or not has_heyoka():
        raise UsageError(f"There is no engine '{name}' here; take scipy, or heyoka where it is installed.")
    # heyoka imports sympy itself, and swallows an interrupt that comes then.
    import sympy  # noqa: F401

    from sysid_trib.simulation.engine_heyoka import compiled

    return compiled(forces)


@cache
def has_heyoka() -> bool:
    """Whether heyoka is installed."""
    return find_spec("heyoka") is not None
