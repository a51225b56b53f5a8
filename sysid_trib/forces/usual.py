"""What is offered where nothing is named: the usual forces, a model to start from, and what it may lack."""

from dataclasses import replace

from sysid_trib.errors import UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library

EFFECTS = "candidate_effects"


def viscous_model(library: ForceLibrary) -> ForceLibrary:
    """The model that a search starts from: viscous friction alone.

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
    return library.select([viscous.symbol])


def further_forces(library: ForceLibrary, start: ForceLibrary) -> ForceLibrary:
    """What a model may lack: the other forces of its library, and the usual effects."""
    effects = load_library(EFFECTS)
    others = [force for force in library if force.symbol not in start.symbols]
    taken = [force.symbol for force in (*start, *others)]
    # One's own force of a symbol goes before the usual effect of the same.
    others += [force for force in effects if force.symbol not in taken]
    return replace(effects, forces=tuple(others))
