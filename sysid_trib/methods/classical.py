"""The classical decrements, one relation between half periods each: Rayleigh (1877) to Wu et al. (2007)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import cleandoc
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.selection import refuse_sensors
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.methods.auxiliary import AuxiliaryModel, energy_balance, same_half_periods
from sysid_trib.methods.half_period_equations import Equations
from sysid_trib.methods.indirect import as_identification, indirect_estimate
from sysid_trib.methods.scope import Method, MethodScope, scope_of
from sysid_trib.records.inputs import refuse_inputs
from sysid_trib.results.signal_scale import in_units_of_the_motion

SOLID_FRICTION, VISCOUS_FRICTION, QUADRATIC_FRICTION = "sign(v)", "2*v", "v*abs(v)"
FRICTION_WORDS = {SOLID_FRICTION: "solid", VISCOUS_FRICTION: "viscous", QUADRATIC_FRICTION: "quadratic"}
BOTH = {SOLID_FRICTION: 1e-3, VISCOUS_FRICTION: 0.0097}


@dataclass(frozen=True)
class ClassicalMethod:
    """A decrement: equations between the extrema of half periods, with a steady frequency.

    Parameters
    ----------
    correct : bool
        Whether indirect inference removes the bias of half-sines and of the relation.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the errors are those of a motion with a random force: `estimated` estimates the force from the
        extrema; a number is its one-sided density, which is fixed; `auto` leaves the choice to `identify`.
    """

    scope: ClassVar[MethodScope]
    FORMULAS: ClassVar[tuple[str, ...]] = ()
    _relation: ClassVar[Any]  # see `decrement`
    _beta: ClassVar[Any] = staticmethod(np.asarray)
    _rates: ClassVar[bool] = False

    correct: bool = True
    random_force: RandomForceOption = "auto"

    def __post_init__(self) -> None:
        check_random_force(self.random_force)

    @in_units_of_the_motion
    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` that the method describes from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library lacks a force, or the decay has too few half periods.
        UsageError
            Several decays were given.
        """
        decay = one_record(self, decay)
        asked = self.forces_of(library)
        groups = {"envelope": self.equations(asked), "frequency": same_half_periods}
        # A varying frequency does not indicate a random force: estimate the force from the envelope alone.
        auxiliary = AuxiliaryModel(groups, self.values, asked)
        estimate = indirect_estimate(auxiliary, [decay], correct=self.correct, random_force=self.random_force)
        return as_identification(self, decay, asked, estimate, library)

    def forces_of(self, library: ForceLibrary) -> ForceLibrary:
        """Return the forces of a library that the method identifies."""
        return needed_forces(library, self.FORMULAS, self.scope.sentence_label)

    def equations(self, library: ForceLibrary) -> Equations:
        """Return the equations of these forces."""
        return self._relation

    def values(self, parameters: Array) -> Array:
        """Return coefficients and w (rad/s) from the parameters and, last, half a period (s)."""
        half = parameters[-1] / np.pi
        coefficients = parameters[:-1] * (half if self._rates else 1.0)
        damping = [at for at, formula in enumerate(self.FORMULAS) if formula == VISCOUS_FRICTION]
        beta = self._beta(coefficients[damping])
        # Factor by which damping lowers the frequency of the half periods.
        stretch = np.hypot(1.0, np.sum(beta))
        coefficients /= stretch if self._rates else 1.0
        coefficients[damping] = beta / stretch
        return np.append(coefficients, stretch / half)


def decrement(
    name: str,
    relation: Equations,
    label: str,
    forces: Mapping[str, float],
    *,
    beta: Callable[[Array], Array] = np.asarray,
    rates: bool = False,
) -> type[ClassicalMethod]:
    """Return a classical method for a relation between half periods.

    Parameters
    ----------
    name : str
        Name of the class.
    relation : callable
        Function from extrema and times to design and target (see `Equations`). Its docstring is that of the
        method.
    label : str
        Label of the method in tables and sentences.
    forces : mapping of str to float
        Formulas of the forces, in the order of the parameters, and their coefficients in an example decay
        with these forces only. The parameter of `2*v` gives zeta.
    beta : callable
        Function from the parameter of `2*v` to beta = zeta/sqrt(1 - zeta^2); by default the parameter is beta
        itself.
    rates : bool
        Whether parameters are coefficients times w and the target is a rate; the forces are then weak.
    """
    words = [FRICTION_WORDS.get(formula, formula) for formula in forces]
    what = f"{' and '.join(words)} friction"
    assumes = f"{'weak ' if rates else ''}{what} and a linear spring, nothing else"
    summary, _, notes = cleandoc(relation.__doc__ or "").partition("\n\n")
    options = cleandoc(ClassicalMethod.__doc__ or "").partition("\n\n")[2]
    members = {
        "__doc__": f"{summary}\n\n{options}\n\n{notes}".strip(),
        "__module__": relation.__module__,
        "_relation": staticmethod(relation),
        "FORMULAS": tuple(forces),
        "_beta": staticmethod(beta),
        "_rates": rates,
        "scope": MethodScope(label, assumes, "extrema", what, several_runs=False, example=forces),
    }
    return type(name, (ClassicalMethod,), members)


def _logarithmic(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return the damping ratio zeta from ln |X_i/X_i+1| = pi zeta/sqrt(1 - zeta^2), and the frequency.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.0097}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "zeta", st.methods.LogarithmicDecrement())
    >>> found.coefficient.round(5).values.tolist()
    [0.0097]
    """
    return np.full((len(time) - 1, 1), np.pi), -np.diff(np.log(extremum))


def _linear(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return the solid friction lambda (rad) from |X_i| - |X_i+1| = 2 lambda, and the frequency.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 2e-3}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "lambda", st.methods.LinearDecrement())
    >>> found.coefficient.round(5).values.tolist()
    [0.002]
    """
    return np.full((len(time) - 1, 1), 2.0), -np.diff(extremum)


def _turning_points(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return the solid friction lambda (rad) and damping ratio zeta from turning points, and the frequency.

    Notes
    -----
    |X_i+1| = q |X_i| - lambda (1 + q), with q = exp(-pi beta) and beta = zeta/sqrt(1 - zeta^2), is exact. It
    is solved in the form |X_i| - |X_i+1| = tanh(pi beta/2) (|X_i| + |X_i+1|) + 2 lambda, in which the noises
    of difference and sum are uncorrelated.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 1e-3, "zeta": 0.0097}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "lambda,zeta", st.methods.FeenyLiang())
    >>> found.coefficient.round(4).values.tolist()
    [0.001, 0.0097]
    """
    both = extremum[:-1] + extremum[1:]
    return np.column_stack([np.full(len(both), 2.0), both]), -np.diff(extremum)


# Value of tanh(pi beta/2) for a damping ratio near one, at which the motion no longer oscillates.
LARGEST = 1.0 - 1e-12


def _beta_of_turning_points(tanh: Array) -> Array:
    return np.asarray(2.0 / np.pi * np.arctanh(np.clip(tanh, -LARGEST, LARGEST)))


def _energy(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return the solid friction lambda (rad) and damping ratio zeta from dE/dt, E = a^2/2, and the frequency.

    Notes
    -----
    dE/dt = -(2/pi) w lambda sqrt(2 E) - 2 w zeta E, from one half period before to one half period after.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 1e-3, "zeta": 0.0097}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "lambda,zeta", st.methods.EnergyDecay())
    >>> found.coefficient.round(4).values.tolist()
    [0.001, 0.0097]
    """
    before, after = extremum[:-2], extremum[2:]
    twice = 0.25 * (before + after) ** 2
    rate = 0.5 * (after**2 - before**2) / (time[2:] - time[:-2])
    return np.stack([-2.0 / np.pi * np.sqrt(twice), -twice], axis=1), rate


def _inverse_amplitude(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return the quadratic friction delta from the linear growth of 1/a, and the frequency.

    Notes
    -----
    d(1/a)/dt = (4/(3 pi)) w delta.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"delta": 0.1}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "delta", st.methods.QuadraticDecay())
    >>> found.coefficient.round(4).values.tolist()
    [0.1]
    """
    return 4.0 / (3.0 * np.pi) * np.diff(time)[:, None], np.diff(1.0 / extremum)


LogarithmicDecrement = decrement(
    "LogarithmicDecrement", _logarithmic, "logarithmic decrement", {VISCOUS_FRICTION: 0.0097}
)
LinearDecrement = decrement("LinearDecrement", _linear, "linear decrement", {SOLID_FRICTION: 2e-3})
FeenyLiang = decrement(
    "FeenyLiang", _turning_points, "Feeny-Liang decrement", BOTH, beta=_beta_of_turning_points
)
EnergyDecay = decrement("EnergyDecay", _energy, "energy decay", BOTH, rates=True)
QuadraticDecay = decrement(
    "QuadraticDecay", _inverse_amplitude, "quadratic decay", {QUADRATIC_FRICTION: 0.1}, rates=True
)


class WuDecrement(ClassicalMethod):
    """Solid friction and all powers of the speed in a library, from the decrement, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether indirect inference removes the bias of half-sines and energy balance.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).

    Notes
    -----
    The energy loss of a half period is the work of the forces along a sine of the mean amplitude a. For
    forces c_p |v|^p sign(v): |X_i| - |X_i+1| = sum of c_p B_p a^p, with B_p the integral of sin^(p+1) over
    half a period: 2 lambda + pi zeta a + (4/3) delta a^2. All powers are estimated at once. An elastic force
    nu x |x|, which changes the duration of half periods with the amplitude, appears as a delta of about -2
    zeta nu; `frequency_birge_ratio` shows it, the envelope does not. Damping of any power lowers the
    frequency to second order; the correction of the bias includes this.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 1e-3, "zeta": 0.0097, "delta": 0.037}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> found = st.identify(decay, "lambda,zeta,delta", st.methods.WuDecrement())
    >>> found.coefficient.round(4).values.tolist()
    [0.001, 0.0097, 0.037]
    """

    scope = MethodScope(
        "Wu decrement",
        "solid friction, powers of the speed and a linear spring, nothing else",
        "extrema",
        "solid friction, powers of the speed",
        several_runs=False,
        example=BOTH | {QUADRATIC_FRICTION: 0.037},
    )

    def forces_of(self, library: ForceLibrary) -> ForceLibrary:
        """Return the powers of the speed in a library, including solid friction.

        Raises
        ------
        DecayError
            The library lacks solid friction or any other power.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.methods.WuDecrement().forces_of(st.load_library("contact_forces")).symbols
        ('lambda', 'zeta', 'delta')
        """
        label = self.scope.sentence_label
        needed_forces(library, [SOLID_FRICTION], label)
        powers = library.select(force.symbol for force in library if _is_power(force))
        if len(powers) < 2:
            raise DecayError(
                f"{label} needs a power of the speed in addition to sign(v), such as 2*v or v*abs(v)."
            )
        return powers

    def equations(self, library: ForceLibrary) -> Equations:
        """Return the energy balance of each half period."""
        return energy_balance(library)


def _is_power(force: Force) -> bool:
    powers = force.degree is not None and force.degree == force.speed_degree
    return powers and force.kind == "force" and force.character == "dissipative"


def one_record(method: Method, decay: Any) -> xr.Dataset:
    """Return the decay itself.

    Raises
    ------
    UsageError
        Several decays were given, or another object, or a record with a known input.
    """
    if not isinstance(decay, xr.Dataset):
        raise UsageError(f"{scope_of(method).sentence_label} takes one record at a time.")
    refuse_inputs(decay)
    return decay


def feeny_liang_decrement(turning_points: ArrayLike) -> tuple[float, float]:
    """Return the solid friction lambda (rad) and damping ratio zeta from exact turning points.

    Parameters
    ----------
    turning_points : (turn,) array of float, rad
        Angles about the equilibrium at which the motion reverses; signed or not.

    Returns
    -------
    solid : float, rad
        Solid friction lambda.
    viscous : float
        Damping ratio zeta.

    Raises
    ------
    DecayError
        There are fewer than three, or they do not decay as under these two forces.

    Examples
    --------
    Under solid friction alone, each turning point is smaller by 2 lambda.

    >>> import sysid_trib as st
    >>> solid, viscous = st.methods.feeny_liang_decrement([0.30, -0.26, 0.22, -0.18])
    >>> round(solid, 6), abs(round(viscous, 6))
    (0.02, 0.0)
    """
    extremum = np.abs(np.asarray(turning_points, dtype=float))
    if len(extremum) < 3:
        raise DecayError(f"{len(extremum)} turning points cannot determine two forces; give at least three.")
    parameters = np.linalg.lstsq(*_turning_points(extremum, extremum), rcond=None)[0]
    if not abs(parameters[1]) < LARGEST:
        raise DecayError("The turning points do not decay as under solid and viscous friction.")
    solid, viscous, _ = FeenyLiang().values(np.append(parameters, 1.0))
    return float(solid), float(viscous)


def needed_forces(library: ForceLibrary, formulas: Sequence[str], method: str) -> ForceLibrary:
    """Return the library's forces of these formulas, for a method by its label.

    Raises
    ------
    DecayError
        One is missing, so that the method does not apply; or there is a sensor term.
    """
    refuse_sensors(library)
    forces = {formula: library.role(formula) for formula in formulas}
    if missing := [formula for formula, force in forces.items() if force is None]:
        raise DecayError(f"{method} needs a force of formula {missing[0]}, and the library has none.")
    return library.select(force.symbol for force in forces.values() if force is not None)
