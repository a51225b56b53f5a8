"""Start forces of a search, and the candidates offered to it."""

from collections.abc import Collection, Iterable
from dataclasses import replace

from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS, HYSTERESIS, INPUTS


def viscous_model(library: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """Return the start model of a search: viscous friction alone, and the first force of each input.

    Raises
    ------
    UsageError
        The library has no viscous friction.
    """
    viscous = [library[symbol] for symbol in library.damping_factors]
    if not viscous:
        wrong = f"Library '{library.title}' has no viscous friction to start from"
        raise UsageError(
            f"{wrong}; name the forces of the start model (--forces {','.join(library.symbols[:2])})."
        )
    return replace(library, forces=(*first_of_inputs(inputs), viscous[0]))


def first_of_inputs(inputs: Collection[str]) -> list[Force]:
    """Return the first force of each input in the library of inputs: `gain` of `u`."""
    driving = {force.inputs: force for force in reversed([*load_library(INPUTS)]) if force.inputs}
    return [force for held, force in driving.items() if set(held) <= set(inputs)]


def with_inputs_acting(
    library: ForceLibrary, inputs: Collection[str], offered: Iterable[Force] = ()
) -> ForceLibrary:
    """Return the library with the first force of each input that none of its forces holds.

    `offered` : forces of the user, which come before the shipped ones.
    """
    for force in offered:
        if {*force.inputs} & {*inputs} - {*library.inputs} and {*force.inputs} <= {*inputs}:
            library = replace(library, forces=(*library, force))
    idle = [name for name in inputs if name not in library.inputs]
    further = [force for force in first_of_inputs(idle) if force.symbol not in library.symbols]
    return replace(library, forces=(*further, *library)) if further else library


def further_forces(library: ForceLibrary, start: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """Return the candidates for a model: other forces of its library and inputs, and the usual effects."""
    effects = load_library(EFFECTS)
    of_inputs = [force for force in load_library(INPUTS) if set(force.inputs) & set(inputs)]
    # A search cannot determine more shape parameters; in a decay, it cannot determine these either.
    of_inputs += [force for force in load_library(HYSTERESIS) if inputs and len(force.shape) < 3]
    others = [force for force in (*library, *of_inputs) if force.symbol not in start.symbols]
    taken = [force.symbol for force in (*start, *others)]
    # A user's own force precedes the usual effect of the same symbol.
    others += [force for force in effects if force.symbol not in taken]
    return replace(effects, forces=tuple(others))


def offered_forces(
    model: ForceLibrary, candidates: ForceLibrary, inputs: Collection[str]
) -> tuple[ForceLibrary, list[str]]:
    """Return the candidates of these inputs that the model does not have, and the symbols of the others."""
    kept: list[Force] = []
    left_out: list[str] = []
    for force in candidates:
        same = any(_same(force, other) for other in model) or not set(force.inputs) <= set(inputs)
        if same or any(force.symbol == other.symbol for other in (*model, *kept)):
            left_out.append(force.symbol)
        else:
            kept.append(force)
    return replace(candidates, forces=tuple(kept)), left_out


def _same(force: Force, other: Force) -> bool:
    """Return true if two forces are the same function."""
    if force.kind != other.kind:
        return False
    plain = force.memoryless and not (force.shape or force.channels or force.uses)
    if plain and force.kind == "force":
        return other.matches(force.formula.text)
    texts = [
        (f.formula.text, *(p.text for table in (f.state, f.memory) for p in table.values()))
        for f in (force, other)
    ]
    return texts[0] == texts[1]
