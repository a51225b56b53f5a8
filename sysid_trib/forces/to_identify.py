"""Which forces of a library a method identifies."""

from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary


def forces_to_identify(library: ForceLibrary, reference_frequency: float | None) -> ForceLibrary:
    """The forces to identify: without a given frequency the one of formula `x` is the frequency itself.

    Parameters
    ----------
    library : ForceLibrary
        All forces offered.
    reference_frequency : float or None, rad/s
        None where it is fitted.

    Returns
    -------
    ForceLibrary

    Raises
    ------
    DecayError
        None remains, or a sensor term is among them: it changes what is measured, not the motion.
    """
    sensors = [force.symbol for force in library if force.kind == "sensor"]
    if sensors:
        raise DecayError(f"'{sensors[0]}' is a sensor term, not a force; leave it out (--forces).")
    stiffness = library.role("x")
    if reference_frequency is None and stiffness is not None:
        library = library.select(s for s in library.symbols if s != stiffness.symbol)
    if not len(library):
        raise DecayError("No force is left to identify beside the frequency; offer at least one (--forces).")
    return library
