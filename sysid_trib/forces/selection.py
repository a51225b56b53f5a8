"""Which forces of a library a method identifies, and which are offered where nothing is named."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library


def forces_to_identify(
    library: ForceLibrary, reference_frequency: float | None, *, sensors: bool = False
) -> ForceLibrary:
    """The forces to identify: without a given frequency the one of formula `x` is the frequency itself.

    Parameters
    ----------
    library : ForceLibrary
        All forces offered.
    reference_frequency : float or None, rad/s
        None where it is fitted.
    sensors : bool
        Whether the method knows terms of the sensor.

    Returns
    -------
    ForceLibrary

    Raises
    ------
    DecayError
        None remains, or there is a sensor term that the method does not know.
    """
    if not sensors:
        refuse_sensors(library)
    stiffness = library.role("x")
    if reference_frequency is None and stiffness is not None:
        library = library.select(s for s in library.symbols if s != stiffness.symbol)
    if all(force.kind == "sensor" for force in library):
        raise DecayError("No force is left to identify beside the frequency; offer at least one (--forces).")
    return library


def is_free_to_move(library: ForceLibrary, fixed: Mapping[str, float]) -> bool:
    """True if a motion may be anywhere: the only force that holds `x` takes the restoring one away.

    Parameters
    ----------
    library : ForceLibrary
    fixed : mapping of str to float
        Coefficients that are held.
    """
    restoring = library.role("-x")
    others = (force for force in library if force is not restoring)
    held = restoring is not None and fixed.get(restoring.symbol) == 1.0
    return held and not any("x" in formula.names for force in others for formula in force.formulas)


def refuse_sensors(library: ForceLibrary) -> None:
    """Refuse terms of the sensor, for a method that does not know them.

    Raises
    ------
    DecayError
        A sensor term is in the library.
    """
    sensors = [force.symbol for force in library if force.kind == "sensor"]
    if sensors:
        raise DecayError(
            f"'{sensors[0]}' is a sensor term: it changes what is measured, not the motion; "
            "methods.Direct and methods.Trajectory identify it, leave it out for others (--forces)."
        )


EFFECTS, INPUTS = "candidate_effects", "inputs"


def viscous_model(library: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """The model that a search starts from: viscous friction alone, and the first force of each input.

    Raises
    ------
    UsageError
        The library has none.
    """
    viscous = library.role("2*v") or library.role("v")
    if viscous is None:
        raise UsageError(
            f"Library '{library.title}' has no viscous friction to start from; name the forces of the start "
            f"model (--forces {','.join(library.symbols[:2])})."
        )
    driving = {force.inputs: force for force in reversed([*load_library(INPUTS)]) if force.inputs}
    first = (force for held, force in driving.items() if set(held) <= set(inputs))
    return replace(library, forces=(*first, viscous))


def further_forces(library: ForceLibrary, start: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """What a model may lack: the other forces of its library and of inputs, and the usual effects."""
    effects = load_library(EFFECTS)
    of_inputs = [force for force in load_library(INPUTS) if set(force.inputs) & set(inputs)]
    others = [force for force in (*library, *of_inputs) if force.symbol not in start.symbols]
    taken = [force.symbol for force in (*start, *others)]
    # One's own force of a symbol goes before the usual effect of the same.
    others += [force for force in effects if force.symbol not in taken]
    return replace(effects, forces=tuple(others))
