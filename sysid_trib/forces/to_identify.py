"""Which forces of a library a method identifies."""

from collections.abc import Mapping

from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary


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
    """Whether a motion may be anywhere: the only force that holds `x` takes the restoring one away.

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
