"""Forces that cannot be separated: by averaging, or by any method.

Averaging cannot separate forces whose signatures are linearly dependent. No method can separate forces that
are linearly dependent in every motion.
"""

import numpy as np

from sysid_trib.arrays import Array, dependent_columns
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.simulation.internal_states import states_along

AMPLITUDES = 96
COMPARED_POINTS = 2000
# Range of times at which forces that depend on `t` are compared (s): any amplitude may occur at any time.
LATEST_TIME = 20.0


def indistinguishable(
    library: ForceLibrary, amplitude_low: float, amplitude_high: float, *, shapes: ShapeValues | None = None
) -> list[tuple[str, ...]]:
    """Return groups of forces whose signatures are linearly dependent: no averaging method can separate them.

    Parameters
    ----------
    library : ForceLibrary
        The forces; terms of the sensor have no effect on the envelope equations and are left out.
    amplitude_low, amplitude_high : float, rad
        The range of amplitudes in which they are compared.
    shapes : mapping of str to float, optional
        Shape parameters; default values for missing ones.

    Returns
    -------
    list of tuple of str
        Groups of two or more symbols: first sets of forces with proportional signatures, then larger
        combinations in which one force is a sum of the others. Forces with zero signature are in no group
        (`without_signature`).

    Raises
    ------
    UsageError
        Not 0 <= amplitude_low < amplitude_high.

    Examples
    --------
    An elastic force `x**3` and an inertial one shift the frequency alike: averages cannot separate them.

    >>> import sysid_trib as st
    >>> library = st.library("zeta,epsilon", inertial="x*v**2")
    >>> st.forces.indistinguishable(library, 0.05, 0.5)
    [('epsilon', 'inertial')]
    """
    forces, table = _signature_table(library, amplitude_low, amplitude_high, shapes)
    return [tuple(forces[i].symbol for i in group) for group in dependent_columns(table)]


def without_signature(library: ForceLibrary, amplitude: float, shapes: ShapeValues | None) -> tuple[str, ...]:
    """Return the forces that averaging neglects up to an amplitude (rad), such as even forces."""
    forces, table = _signature_table(library, 0.02 * amplitude, amplitude, shapes)
    return tuple(force.symbol for force, column in zip(forces, table.T, strict=True) if not column.any())


def averages_decide(
    library: ForceLibrary, amplitude: float, *, frequency_free: bool = True, shapes: ShapeValues | None = None
) -> bool:
    """Return true if averages over cycles up to an amplitude (rad) separate the forces and the frequency."""
    _, table = _signature_table(library, 0.02 * amplitude, amplitude, shapes)
    if frequency_free and library.role("x") is None:
        # In averaged equations, a fitted frequency has the effect of a force with the formula x.
        of_x = np.concatenate([np.zeros(AMPLITUDES), np.linspace(0.02 * amplitude, amplitude, AMPLITUDES)])
        table = np.column_stack([table, of_x])
    return bool(table.any(axis=0).all()) and not dependent_columns(table)


def inseparable(first: Force, second: Force, amplitude: float, shapes: ShapeValues | None = None) -> bool:
    """Return true if two forces act alike, in motions of up to an amplitude (rad) or on average."""
    pair = ForceLibrary("", (first, second))
    if any(force.kind == "sensor" for force in pair):
        return False
    silent = without_signature(pair, amplitude, shapes)
    decided = silent or averages_decide(pair, amplitude, shapes=shapes)
    return not decided or bool(exactly_dependent(pair, amplitude, shapes=shapes))


def exactly_dependent(
    library: ForceLibrary, amplitude: float, *, shapes: ShapeValues | None = None
) -> list[tuple[str, ...]]:
    """Return groups of forces that are linearly dependent in every motion: no method can separate them.

    Parameters
    ----------
    library : ForceLibrary
        The forces; sensors are left out.
    amplitude : float, rad
        Largest angle at which they are compared.
    shapes : mapping of str to float, optional
        Shape parameters; default values for missing ones.

    Returns
    -------
    list of tuple of str
        Groups of symbols.

    Notes
    -----
    Functions of x, v and t are compared at random points. If there are history-dependent forces, all forces
    are compared along one irregular motion.
    """
    forces = [force for force in library if force.kind == "force"]
    random = np.random.default_rng(20190417)
    x, v = amplitude * random.uniform(-1.0, 1.0, (2, COMPARED_POINTS))
    t = random.uniform(0.0, LATEST_TIME, COMPARED_POINTS)
    if not all(force.memoryless for force in forces):
        t = np.linspace(0.0, LATEST_TIME, COMPARED_POINTS)
        tau = 5.0 * t
        # Two incommensurate frequencies: the motion comes near every point, along many paths.
        x = 0.5 * amplitude * (np.cos(tau) + np.cos(np.sqrt(2.0) * tau + 1.0))
        v = -0.5 * amplitude * (np.sin(tau) + np.sqrt(2.0) * np.sin(np.sqrt(2.0) * tau + 1.0))
    columns = []
    for force in forces:
        hidden = {} if force.memoryless else states_along(force, tau, x, v, shapes, time=t)
        columns.append(force.value(x, v, t, shapes=shapes, hidden=hidden))
    groups = dependent_columns(np.column_stack(columns)) if columns else []
    return [tuple(forces[i].symbol for i in group) for group in groups]


def _signature_table(
    library: ForceLibrary, low: float, high: float, shapes: ShapeValues | None
) -> tuple[list[Force], Array]:
    """Return the forces, and a matrix with their signatures (sine above cosine) as columns."""
    if not 0.0 <= low < high < np.inf:
        raise UsageError(f"Amplitudes from {low:g} to {high:g} rad are not a range; give 0 <= low < high.")
    amplitude = np.linspace(low, high, AMPLITUDES)
    # Use instants independent of the amplitude: t*v and v must not be dependent because one record relates t
    # to a.
    time = LATEST_TIME * np.random.default_rng(20190417).uniform(size=AMPLITUDES)
    forces = [force for force in library if force.kind == "force"]
    columns = [np.concatenate(averages(force, amplitude, shapes, time)) for force in forces]
    return forces, np.column_stack(columns) if columns else np.zeros((2 * AMPLITUDES, 0))
