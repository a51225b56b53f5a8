"""Selection of forces: those that a method identifies, and forces of the package given by name."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library

# Libraries of the forces that systems name.
EFFECTS, INPUTS, HYSTERESIS = "candidate_effects", "inputs", "hysteresis"
SHIPPED_LIBRARIES = ("contact_forces", EFFECTS, INPUTS, HYSTERESIS, "water")


def forces_to_identify(
    library: ForceLibrary, reference_frequency: float | None, *, sensors: bool = False
) -> ForceLibrary:
    """Return the forces to identify; if the frequency is fitted, a force of formula `x` is left out.

    Parameters
    ----------
    library : ForceLibrary
        All offered forces.
    reference_frequency : float or None, rad/s
        None if it is fitted.
    sensors : bool
        True if the method supports sensor terms.

    Returns
    -------
    ForceLibrary

    Raises
    ------
    DecayError
        No force remains, or there is a sensor term that the method does not support.
    """
    if not sensors:
        refuse_sensors(library)
    stiffness = library.role("x")
    if reference_frequency is None and stiffness is not None:
        library = library.select(s for s in library.symbols if s != stiffness.symbol)
    if all(force.kind == "sensor" for force in library):
        raise DecayError(
            "There is no force to identify, only the frequency; offer at least one force (--forces)."
        )
    return library


def with_shipped(library: ForceLibrary, symbols: Collection[str]) -> ForceLibrary:
    """Add forces that are named and that are in another library of the package."""
    wanted = set(symbols) - set(library.symbols)
    shipped = (force for name in SHIPPED_LIBRARIES if wanted for force in load_library(name))
    lacking = {force.symbol: force for force in shipped if force.symbol in wanted}
    return replace(library, forces=(*library, *lacking.values())) if lacking else library


def is_free_to_move(library: ForceLibrary, fixed: Mapping[str, float]) -> bool:
    """Return true if the body has no restoring force.

    Parameters
    ----------
    library : ForceLibrary
    fixed : mapping of str to float
        Fixed coefficients.
    """
    restoring = library.role("-x")
    others = (force for force in library if force is not restoring)
    held = restoring is not None and fixed.get(restoring.symbol) == 1.0
    return held and not any("x" in formula.names for force in others for formula in force.formulas)


def refuse_sensors(library: ForceLibrary) -> None:
    """Raise an error for sensor terms in a method that does not support them.

    Raises
    ------
    DecayError
        The library contains a sensor term.
    """
    sensors = [force.symbol for force in library if force.kind == "sensor"]
    if sensors:
        wrong = f"'{sensors[0]}' is a sensor term: it changes what is measured, not the motion"
        raise DecayError(f"{wrong}; Direct and Trajectory identify it, leave it out for others (--forces).")


def known_coefficients(library: ForceLibrary) -> dict[str, float]:
    """Return the coefficients stated in a user's library, by symbol; they are fixed.

    The known coefficients of the package's libraries are free if their forces are named, so that the record
    tests these values.
    """
    shipped = {f"{name}.toml": name for name in SHIPPED_LIBRARIES}
    sources = library.source.split(" + ")
    if all(source in shipped for source in sources):
        return {}
    # The library may be a sum of libraries.
    free = {force for source in sources if source in shipped for force in load_library(shipped[source])}
    stated = (force for force in library if force.coefficient is not None and force not in free)
    return {force.symbol: force.coefficient for force in stated if force.coefficient is not None}
