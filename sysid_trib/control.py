"""Views of a model for python-control: nonlinear system, linear system, natural frequency and damping."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force
from sysid_trib.physics.model_estimate import check_quantity, model_estimate, propagate
from sysid_trib.results import schema, variables
from sysid_trib.simulation.model import Model

if TYPE_CHECKING:
    import control

__all__ = ["damp", "linearise", "to_nonlinear_system"]

# Distances from rest (rad) at which the slopes of a force are compared; if they differ, it has no slope.
OUTER_STEP, INNER_STEP = 1e-7, 1e-8
SLOPE_TOLERANCE = 1e-3
# Variables of `damp` for each pole, with units.
POLE = {
    "natural_frequency": ("natural frequency", "rad/s"),
    "damping_ratio": ("damping ratio", "1"),
    "growth_rate": ("real part of the pole", "rad/s"),
    "frequency": ("imaginary part of the pole", "rad/s"),
}


def to_nonlinear_system(
    model: Model | xr.Dataset, inertia: float | None = None
) -> "control.NonlinearIOSystem":
    """Return the model as a nonlinear system of python-control.

    Parameters
    ----------
    model : Model or Dataset
        A model, or an identification.
    inertia : float, kg m^2, optional
        Moment of inertia.

    Returns
    -------
    control.NonlinearIOSystem
        States and outputs are `theta` (rad), `theta_dot` (rad/s) and the internal states of forces
        (`dahl_z`); the input is `torque`: N m with an inertia, otherwise torque over inertia, rad/s^2. The
        parameters are the coefficients. `t` in a formula is the time of the simulation. Sensor terms are
        omitted.

    Raises
    ------
    UsageError
        A force has memory, which python-control cannot keep between reversals.

    Notes
    -----
    Simulate with `solve_ivp_method="LSODA"` and `solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12}`. When dry
    friction holds the oscillator, this integrator switches endlessly in small steps; `simulate` is exact
    there.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.05, "epsilon": 0.3}, reference_frequency=10.0)
    >>> system = st.control.to_nonlinear_system(model)
    >>> time = np.linspace(0.0, 5.0, 101)
    >>> motion = control.input_output_response(system, time, 0.0, [0.3, 0.0], solve_ivp_kwargs={"rtol": 1e-9})
    >>> motion.states[0, -1].round(4).item(), st.simulate(model, time, angle=0.3).angle[-1].round(4).item()
    (0.0238, 0.0238)
    """
    import control

    given = (model if isinstance(model, Model) else schema.model_of(model)).bound
    _refuse_memory(given)
    gain = _gain(inertia)

    def update(t: float, state: Any, inputs: Any, params: Mapping[str, float]) -> Array:
        rates = _field(given, params, state, t)
        rates[1] += gain * np.atleast_1d(inputs)[0]
        return rates

    coefficients = {force.symbol: given.coefficients[force.symbol] for force in given.forces}
    labels = _labels(_states(given.forces))
    return control.nlsys(update, lambda t, state, inputs, params: state, params=coefficients, **labels)


def linearise(
    model: Model | xr.Dataset, amplitude: float | None = None, inertia: float | None = None
) -> "control.StateSpace":
    """Return the model as a linear system about rest, or about a cycle.

    Parameters
    ----------
    model : Model or Dataset
        A model, or an identification.
    amplitude : float, rad, optional
        Every force is replaced by its describing function at this amplitude, with stiffness 2 <h cos phi>/a
        and damping -2 <h sin phi>/a. None: the slopes at rest are used; a force without slopes there, such as
        dry friction or a detent, is omitted.
    inertia : float, kg m^2, optional
        As in `to_nonlinear_system`.

    Returns
    -------
    control.StateSpace
        States and outputs are `theta` (rad) and `theta_dot` (rad/s), the input is `torque`; at rest also the
        internal states of the remaining forces. For a cycle, `t` in formulas is zero.

    Raises
    ------
    UsageError
        At rest, a force has memory or depends on `t`; or the amplitude is not positive.
    LibraryError
        A force is not finite on such a cycle.

    Examples
    --------
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.05, "epsilon": 0.3}, reference_frequency=10.0)
    >>> st.control.linearise(model).A.round(2).tolist()
    [[0.0, 1.0], [-100.0, -1.0]]
    >>> st.control.linearise(model, amplitude=1.0).A.round(2).tolist()
    [[0.0, 1.0], [-122.5, -1.0]]
    """
    import control

    given = (model if isinstance(model, Model) else schema.model_of(model)).bound
    matrix, names = _at_rest(given) if amplitude is None else _about_a_cycle(given, amplitude)
    size = len(names)
    enters = np.zeros((size, 1))
    enters[1] = _gain(inertia)
    return control.ss(matrix, enters, np.eye(size), np.zeros((size, 1)), **_labels(names))


def damp(model: Model | xr.Dataset, amplitude: float | None = None) -> xr.Dataset:
    """Return the natural frequency and damping ratio of the linearised model, by python-control.

    Parameters
    ----------
    model : Model or Dataset
        A model, or an identification.
    amplitude : float, rad, optional
        As in `linearise`.

    Returns
    -------
    Dataset
        Over `pole`: `natural_frequency` (rad/s, the magnitude of the pole), `damping_ratio`, and
        `growth_rate` and `frequency` (rad/s), the real and imaginary part of the pole. For an identification,
        each has its standard error from the covariance.

    Raises
    ------
    UsageError, LibraryError
        As in `linearise`.

    Examples
    --------
    Quadratic friction damps a large cycle more than a small one.

    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.0097, "delta": 0.037}, reference_frequency=9.91)
    >>> poles = [st.control.damp(model, amplitude) for amplitude in (0.01, 0.3)]
    >>> [pole.damping_ratio[0].round(4).item() for pole in poles]
    [0.0099, 0.0144]
    """
    import control

    def modes(of: Model) -> Array:
        natural, ratio, poles = control.damp(linearise(of, amplitude), doprint=False)
        # The order of a conjugate pair is independent of rounding errors in the magnitudes.
        order = np.lexsort((poles.imag, np.round(natural / of.reference_frequency, 9)))
        return np.stack([natural, ratio, poles.real, poles.imag])[:, order]

    if isinstance(model, Model):
        of_poles = zip(POLE.items(), modes(model), strict=True)
        return xr.Dataset({name: variables.variable("pole", v, *meaning) for (name, meaning), v in of_poles})
    estimate = model_estimate(model)
    values, errors = propagate(lambda z: modes(estimate.model(z)), estimate.values, estimate.covariance)
    data: variables.Variables = {}
    for value, error, (name, meaning) in zip(values, errors, POLE.items(), strict=True):
        data |= variables.with_error(name, "pole", (value, error), *meaning)
    return xr.Dataset(data)


def _states(forces: Iterable[Force]) -> list[str]:
    return ["theta", "theta_dot", *(f"{force.symbol}_{name}" for force in forces for name in force.state)]


def _labels(states: list[str]) -> dict[str, Any]:
    """Return the names in python-control for a system whose states are all outputs."""
    return {"states": states, "outputs": states, "inputs": ["torque"], "name": "oscillator"}


def _gain(inertia: float | None) -> float:
    if inertia is None:
        return 1.0
    check_quantity("inertia", inertia)
    return 1.0 / inertia


def _refuse_memory(model: Model) -> None:
    for force in model.forces:
        if force.memory:
            raise UsageError(
                f"Force '{force.symbol}' keeps values from its reversals, which "
                f"python-control cannot do; leave it "
                "out, or linearise at an amplitude."
            )


def _field(model: Model, coefficients: Mapping[str, float], state: Any, time: float) -> Array:
    """Return the rates of theta, theta_dot and the internal states (per s), without the input."""
    w = model.reference_frequency
    x, rate, *inner = np.asarray(state, dtype=float).tolist()
    rates = [rate, -(w**2) * x]
    for force in model.forces:
        hidden, inner = dict(zip(force.state, inner, strict=False)), inner[len(force.state) :]
        names = {"x": x, "v": rate / w, "t": time, **hidden, **force.shape_values(model.shapes)}
        h = force.value(x, rate / w, time, shapes=model.shapes, hidden=hidden)
        rates[1] -= w**2 * coefficients[force.symbol] * float(h)
        rates += [w * float(formula.evaluate(names)) for formula in force.state.values()]
    return np.array(rates, dtype=float)


def _about_a_cycle(model: Model, amplitude: float) -> tuple[Array, list[str]]:
    """Return the system matrix with the describing functions of all forces, and the names of its states."""
    check_quantity("amplitude", amplitude)
    w = model.reference_frequency
    sums = np.zeros(2)
    for force in model.forces:
        sine, cosine = averages(force, np.array([amplitude]), model.shapes)
        sums += model.coefficients[force.symbol] * 2.0 / amplitude * np.array([cosine[0], -sine[0]])
    return np.array([[0.0, 1.0], [-(w**2) * (1.0 + sums[0]), -w * sums[1]]]), ["theta", "theta_dot"]


def _at_rest(model: Model) -> tuple[Array, list[str]]:
    """Return states and the derivatives of the rates by them at rest; forces without slopes are omitted."""
    _refuse_memory(model)
    timed = next((f.symbol for f in model.forces if f.holds_time), None)
    if timed is not None:
        raise UsageError(f"Force '{timed}' changes in time: no linear system is fixed; leave it out.")
    w = model.reference_frequency
    kept = [(f, slopes) for f in model.forces if (slopes := _slopes(f, model)) is not None]
    names = _states(force for force, _ in kept)
    matrix = np.zeros((len(names), len(names)))
    matrix[:2, :2] = [[0.0, 1.0], [-(w**2), 0.0]]
    at = 2
    for force, slopes in kept:
        indices = np.array([0, 1, *range(at, at + len(force.state))])
        at += len(force.state)
        # Formulas are functions of v = theta'/w.
        slopes[:, 1] /= w
        matrix[1, indices] -= w**2 * model.coefficients[force.symbol] * slopes[0]
        matrix[np.ix_(indices[2:], indices)] += w * slopes[1:]
    return matrix, names


def _slopes(force: Force, model: Model) -> Array | None:
    """Return the slopes of h and of the state rates at rest by (x, v, states); None if h has none."""
    names = ("x", "v", *force.state)

    def names_at(z: Array) -> dict[str, Any]:
        return {"t": 0.0, **dict(zip(names, z, strict=True)), **force.shape_values(model.shapes)}

    units, rest = np.eye(len(names)), names_at(np.zeros(len(names)))
    # A slope at rest must be the same for every direction and for two distances.
    directions = [*units, *-units, *np.random.default_rng(5).standard_normal((4, len(names)))]
    with np.errstate(all="ignore"):
        formulas = (force.formula, *force.state.values())
        slopes = np.array([[float(f.derivative(rest, name)) for name in names] for f in formulas])
        origin = float(force.formula.evaluate(rest))
        tolerance = SLOPE_TOLERANCE * max(1.0, np.abs(slopes[0]).max())
        for step in (OUTER_STEP, INNER_STEP):
            for u in directions:
                rise = float(force.formula.evaluate(names_at(step * u))) - origin
                if not abs(rise / step - slopes[0] @ u) <= tolerance:
                    return None
    return slopes


def __dir__() -> list[str]:
    return __all__
