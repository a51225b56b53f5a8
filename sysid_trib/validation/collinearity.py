"""Identifiability: parameters that driven records cannot separate, and a motion that would."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.motion_fit.moving_samples import MovingSamples, columns_of, points_of, regressed
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results.variables import described

FREQUENCY_PARAMETER = "frequency"
# Parameters are not separated if their errors exceed those with all others known by this factor.
INSEPARABLE = 10.0
# Largest stated inflation; beyond it the columns are identical.
MOST_INFLATED = 1e4
# Inflation above which no number is stated.
ALIKE_FROM = 1e3
# A parameter belongs to an undetermined combination if its component is at least this.
MEMBER_PART = 0.2
# Factors of a variable of the formulas for trial motions, and the least gain that makes an advice.
TRIED_FACTORS, WORTH_FACTOR = (0.0, 2.0), 3.0


@dataclass(frozen=True)
class Combination:
    """Parameters that are not separated.

    Attributes
    ----------
    members : tuple of str
        Their names.
    inflation : float
        Largest ratio of an error to the error of the parameter alone.
    advice : str
        Motion that separates them; empty if there is none.
    """

    members: tuple[str, ...]
    inflation: float
    advice: str

    @property
    def sentence(self) -> str:
        """Sentence on the combination."""
        names = " and ".join([", ".join(self.members[:-1]), self.members[-1]])
        said = f"These runs do not separate {names}"
        said += (
            ""
            if self.inflation >= ALIKE_FROM
            else f" (errors {self.inflation:.0f} times those of each alone)"
        )
        return f"{said}; {self.advice} does." if self.advice else f"{said}."


def identifiability(
    decay: Decays, library: ForceLibrary, *, constraints: ConstraintTable = NO_CONSTRAINTS
) -> xr.Dataset:
    """Find the parameters that driven records cannot separate, before a fit.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One run or several with `angle(time)` and inputs.
    library : ForceLibrary
        The offered forces.
    constraints : mapping
        Held coefficients are known, which helps to separate the others.

    Returns
    -------
    Dataset
        Over `parameter`, the coefficients and the frequency: `inflation`, the factor by which the error is
        larger than with all others known. Attribute `sentences`: a line for each combination that is not
        separated, with the motion that would separate it.

    Notes
    -----
    The columns are the forces along the smoothed records, without samples that may be at rest. Coefficients
    in formulas of other forces are estimated by a regression. The inflation is the root of the variance
    inflation factor (Belsley, Kuh and Welsch 1980).

    Examples
    --------
    The record is driven at one frequency only: spring and inertia act alike there.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> forces, time = st.library(st.load_library("inputs")["gain"], "zeta"), np.arange(0.0, 20.0, 0.02)
    >>> model = st.Model(forces, {"gain": 0.05, "zeta": 0.1}, 10.0)
    >>> record = st.simulate(model, time, inputs={"u": np.sin(7.0 * time)}).sel(time=slice(10.0, None))
    >>> found = st.validation.identifiability(record, forces)
    >>> found.inflation.round(0).to_series().to_dict()
    {'gain': 274.0, 'zeta': 73.0, 'frequency': 263.0}
    """
    runs = as_runs(decay, driven=True)
    held = Constraints(constraints).fixed
    offered = forces_to_identify(library, None, sensors=True)
    points = points_of(runs, offered)
    known = regressed(points, offered, held).coefficients
    forces = [force for force in offered.bound(known) if force.symbol not in held]
    names = (*(force.symbol for force in forces), FREQUENCY_PARAMETER)
    columns = columns_of(points, forces)
    inflation = _inflation(columns)
    combinations = _combinations(points, forces, names)
    result = xr.Dataset(described("identifiability", {"inflation": inflation}), {"parameter": list(names)})
    return result.assign_attrs(sentences="\n".join(combination.sentence for combination in combinations))


def _inflation(columns: Array) -> Array:
    """Return the error of each parameter over its error alone, (parameter,), at most `MOST_INFLATED`."""
    unit = _of_unit_size(columns)
    values, axes = np.linalg.eigh(unit.T @ unit)
    inverse = np.sum(axes**2 / np.maximum(values, MOST_INFLATED**-2), axis=1)
    return np.asarray(np.where(unit.any(axis=0), np.minimum(np.sqrt(inverse), MOST_INFLATED), MOST_INFLATED))


def _of_unit_size(columns: Array) -> Array:
    """Return columns divided by their norms; a column of zeros is unchanged."""
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(size > 0.0, size, 1.0))


def _combinations(points: MovingSamples, forces: Sequence[Force], names: Sequence[str]) -> list[Combination]:
    """Return the combinations that are not separated, the worst first; each parameter is in at most one."""
    columns, open_, combinations = columns_of(points, forces), np.ones(len(names), bool), list[Combination]()
    while open_.sum() > 1:
        places = np.flatnonzero(open_)
        inflation = _inflation(columns[:, places])
        if inflation.max() < INSEPARABLE:
            break
        part = _of_unit_size(columns[:, places])
        _, axes = np.linalg.eigh(part.T @ part)
        taking_part = np.abs(axes[:, 0]) >= MEMBER_PART
        members, worst = places[taking_part], float(inflation[taking_part].max(initial=0.0))
        if len(members) < 2 or worst < INSEPARABLE:
            break
        advice = _advice(points, forces, members, worst)
        combinations.append(Combination(tuple(names[at] for at in members), worst, advice))
        # Without one of them the others may be separated.
        open_[places[np.argmax(np.abs(axes[:, 0]))]] = False
    return combinations


def _advice(points: MovingSamples, forces: Sequence[Force], members: Array, worst: float) -> str:
    """Return the motion that best separates parameters: one variable of their formulas is 0, or doubled."""
    among = {name for at in members if at < len(forces) for name in forces[at].formula.names}
    best, said = worst, ""
    for name in sorted(among & points.names.keys() - {"t"}):
        for factor in TRIED_FACTORS:
            if factor == 0.0 and name in ("x", "v"):
                continue
            other = {**points.names, name: factor * points.names[name]}
            # Only the columns are evaluated; the equation of motion is not solved again.
            tried = replace(
                points,
                names={key: np.append(values, other[key]) for key, values in points.names.items()},
                acceleration=np.append(points.acceleration, points.acceleration),
            )
            inflation = float(_inflation(columns_of(tried, forces))[members].max())
            if inflation < best:
                best, said = inflation, _motion_with(name, factor)
    return said if best * WORTH_FACTOR <= worst else ""


def _motion_with(name: str, factor: float) -> str:
    """Describe a motion in which a variable is changed."""
    if name == "x":
        return "a swing twice as wide"
    if name == "v":
        return "a motion twice as fast"
    return f"a run in which {name} is 0" if factor == 0.0 else f"a run in which {name} is twice as large"
