"""Options of a method or of a search: forces, shapes, constraints and frequencies."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib.commands import app
from sysid_trib.commands.options import MOST, ModelOptions, RecordOptions, SearchOptions
from sysid_trib.errors import UsageError
from sysid_trib.forces import selection
from sysid_trib.forces.constraints import Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import further_forces, viscous_model, with_inputs_acting
from sysid_trib.forces.systems import load_system
from sysid_trib.likelihood.random_force import OPTIONS, RandomForceOption
from sysid_trib.records.inputs import named_inputs
from sysid_trib.results.judged import main_result
from sysid_trib.results.kinds import check_is_model
from sysid_trib.results.random_force import DENSITY_UNITS


def offered_forces(library: str, forces: str | None, alpha: bool) -> ForceLibrary:
    """Return the requested forces, with the linear elastic force if alpha is requested.

    A named force that the library lacks is taken from the libraries of the package.
    """
    whole = load_library(library)
    symbols = list(whole.symbols)
    if forces is not None:
        symbols = [s.strip() for s in forces.split(",") if s.strip()]
        whole = selection.with_shipped(whole, symbols)
    if not symbols:
        raise UsageError(f"--forces '{forces}' names no force; the library has {', '.join(whole.symbols)}.")
    stiffness = whole.role("x")
    if stiffness is not None and alpha:
        symbols.append(stiffness.symbol)
    elif stiffness is not None and set(symbols) == {stiffness.symbol}:
        raise UsageError(
            f"Force '{stiffness.symbol}' cannot be separated from the frequency: give --omega0 or "
            "--reference-frequency, or further forces."
        )
    return whole.select(symbols)


@dataclass(frozen=True)
class AskedModel:
    """Model to be identified, with the fixed forces of the system.

    Attributes
    ----------
    library : ForceLibrary
        The forces.
    shapes : dict of str to float
        Fixed shape parameters.
    constraints : ConstraintTable
        Constraints, including those of the system.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
    reference_frequency : float or None, rad/s
        None: fitted.
    contactless : (float, float) or None, rad/s
        Frequency without contact and its standard error.
    """

    library: ForceLibrary
    shapes: dict[str, float]
    constraints: ConstraintTable
    random_force: RandomForceOption
    reference_frequency: float | None
    contactless: tuple[float, float] | None


def asked_model(given: ModelOptions) -> AskedModel:
    """Return the model to identify, with the fixed forces of the system."""
    moving = load_system(given.system)
    contactless = app.parse_value_with_error(given.omega0, "--omega0")
    held = given.reference_frequency
    if contactless and held:
        raise UsageError("--omega0 and --reference-frequency both define alpha: choose one.")
    offered = offered_forces(given.library, moving.with_held(given.forces), bool(contactless or held))
    if given.forces is None:
        # A named input acts on the model, as in `discover`.
        offered = with_inputs_acting(offered, driving_of(given))
    shapes = held_shapes(given.set_, offered)
    constraints = asked_constraints(given.fix, given.bound, given.tie)
    unconstrained = set(offered.symbols) - set(constraints.names)
    always = {symbol: value for symbol, value in moving.held.items() if symbol in unconstrained}
    constraints = Constraints({**moving.bounds(unconstrained), **always, **constraints.table})
    constraints.check(selection.forces_to_identify(offered, held, sensors=True))
    return AskedModel(
        library=offered,
        shapes=shapes,
        constraints=constraints.table,
        random_force=parse_random_force(given.random_force),
        reference_frequency=held,
        contactless=contactless,
    )


def driving_of(given: RecordOptions) -> dict[str, str | int]:
    """Return the columns of inputs by their names."""
    return named_inputs(None if given.input_ is None else given.input_.split(","))


def asked_constraints(fix: list[str], bound: list[str], tie: list[str]) -> Constraints:
    """Parse constraints: `lambda=0`; `zeta=0:1`, either side empty; `nu=-2.356*delta`."""
    form = "LOW:HIGH, of which one side may be empty"
    texts = app.texts_by_name(bound, "--bound", "of the form zeta=0:1")
    bounds = {name: app.parse_window(text, f"--bound {name}", form) for name, text in texts.items()}
    if unbounded := [name for name, ends in bounds.items() if ends == (None, None)]:
        raise UsageError(f"--bound {unbounded[0]} '{texts[unbounded[0]]}' must be {form}.")
    fixed = app.numbers_by_name(fix, "--fix", "of the form lambda=0")
    return Constraints.merged(fixed, bounds, app.texts_by_name(tie, "--tie", 'of the form "nu=-2.356*delta"'))


def asked_search(
    given: SearchOptions, inputs: Collection[str] = ()
) -> tuple[ForceLibrary, ForceLibrary, dict[str, Any]]:
    """Return start model, candidates and options of the search, in the form for `discover`.

    Parameters
    ----------
    given : SearchOptions
        If no forces are given, the start model has viscous friction and the inputs. If no candidates are
        given, they are the other forces of the library and the usual effects. Forces that the system always
        has are fixed, and forces that it cannot have are not offered.
    inputs : collection of str
        Names of the driving inputs.

    Raises
    ------
    UsageError
        The level is not between 0 and 1, the time limit is not positive, or a candidate has the symbol of
        another force of the model, so that the symbol would be ambiguous.
    """
    held = given.reference_frequency
    moving = load_system(given.system)
    forces = given.forces
    if not 0.0 < given.level < 1.0:
        raise UsageError(f"--level '{given.level:g}' must lie between 0 and 1, such as 0.01.")
    if forces is None:
        forces = ",".join(viscous_model(load_library(given.library), inputs).symbols)
    start = offered_forces(given.library, moving.with_held(forces), held is not None)
    offered = load_library(given.candidates or given.library)
    if given.candidates is None:
        offered = further_forces(offered, start, inputs)
    offered = offered.select(symbol for symbol in offered.symbols if symbol not in moving.impossible)
    for force in offered:
        if force.symbol in start.symbols and force.formula.text != start[force.symbol].formula.text:
            raise UsageError(
                f"Candidate '{force.symbol}' ({force.formula.text}) has the symbol of another force of the "
                f"start model ({start[force.symbol].formula.text}); rename one of them."
            )
    options = {
        "reference_frequency": held,
        "constraints": dict(moving.held),
        "max_effects": given.max_effects,
        "refit": given.refit,
        "level": given.level,
        "time_limit": given.time_limit or float("inf"),
    }
    return start, offered, options


def held_shapes(texts: list[str], library: ForceLibrary) -> dict[str, float]:
    """Parse shape parameters of the requested forces, such as `dahl.s=0.02`."""
    known = list(library.shape_values())
    form = f"SHAPE=VALUE; shapes of the forces asked for: {', '.join(known) or 'none'}"
    shapes = app.numbers_by_name(texts, "--set", form)
    for name in shapes:
        if name not in known:
            raise UsageError(f"--set '{name}' must be {form}.")
    return shapes


def parse_random_force(text: str) -> RandomForceOption:
    """Parse a word of `OPTIONS`, or a density in (rad/s^2)^2/Hz."""
    word = text.strip()
    density = float("nan")
    if word in OPTIONS:
        return word  # type: ignore[return-value]
    with suppress(ValueError):
        density = float(word)
    if not 0.0 <= density <= MOST:
        raise UsageError(
            f"--random-force '{word}' must be auto, estimated, off, or a density from 0 to {MOST:g} "
            f"{DENSITY_UNITS}."
        )
    return density


def model_of_file(result: Path, tree: xr.DataTree) -> xr.Dataset:
    """Return the identification that represents a saved result; raise an error if there is none."""
    check_is_model(tree, str(result))
    answer = main_result(tree)
    if answer is None:
        raise UsageError(f"{result} contains no model that follows its record; give a result of identify.")
    return answer
