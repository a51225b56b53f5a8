"""The system and the forces that the backbones of a record suggest for an identification."""

from typing import NamedTuple

import xarray as xr

from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import with_shipped
from sysid_trib.forces.systems import load_system

# Number of amplitudes that an identification needs for each of its forces.
AMPLITUDES_A_FORCE = 3


class Suggested(NamedTuple):
    """A system and the forces to identify: `system, forces = suggested(...)`.

    Attributes
    ----------
    system : str
        Name of the system, empty if none.
    forces : tuple of str
        Symbols of the forces.
    """

    system: str
    forces: tuple[str, ...]


def suggested(looked: xr.DataTree, system: str | None = None) -> Suggested:
    """Return the system that follows from the backbones, and forces that the decays can determine.

    Parameters
    ----------
    looked : DataTree
        Result of `look`.
    system : str, optional
        A known system, by its name or file; its forces are suggested in place of those of the backbones.

    Returns
    -------
    Suggested
        The pair `system, forces`: the usual forces of the system. A decay that is too short for them, which
        has fewer than three amplitudes for each force, gets those that follow from its backbone, among them
        viscous friction.

    Raises
    ------
    UsageError
        There is no such system.

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.forces.suggested(st.look(st.records.paper_twin()))
    Suggested(system='', forces=('lambda', 'zeta', 'delta', 'nu', 'epsilon'))
    """
    decays = [node.to_dataset() for name, node in looked.children.items() if name.startswith("decay")]
    systems = {str(decay.attrs["points_to_system"]) for decay in decays}
    of_record = systems.pop() if len(systems) == 1 else ""
    moving = load_system(system or of_record or None)
    # One value of envelope and of frequency per amplitude, for the forces and the frequency.
    most = max(1, sum(decay.sizes["instant"] for decay in decays) // AMPLITUDES_A_FORCE)
    if len(moving.usual) <= most:
        return Suggested(moving.name, moving.usual)
    library = load_library()
    pointed = [s for decay in decays for s in str(decay.attrs["points_to_forces"]).split(",") if s]
    if not pointed:
        by_damping = [library.role(decay.attrs["damping_law"]) for decay in decays]
        pointed = [force.symbol for force in by_damping if force is not None]
    if system is not None:
        # The user knows the system.
        pointed = [*moving.usual]
    elif of_record:
        pointed = [symbol for symbol in pointed if symbol in moving.forces]
    # Drag alone, or dry friction alone, may fit within the band, but every body has some viscous friction.
    viscous = [*library.damping_factors][:1]
    kept = [*dict.fromkeys([*viscous, *pointed])][:most]
    return Suggested(moving.name, tuple(s for s in with_shipped(library, kept).symbols if s in kept))
