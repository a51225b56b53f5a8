"""Methods with other options: constraints, and a random force."""

from dataclasses import fields, is_dataclass, replace

from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import known_coefficients
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.methods.scope import Constrained, Method, scope_of


def constrained(method: Method, constraints: Constraints) -> Method:
    """Return the method with constraints on its coefficients and shape parameters.

    Parameters
    ----------
    method : Method
        The method without constraints.
    constraints : Constraints
        Fixed values, bounds and ties.

    Raises
    ------
    UsageError
        The method does not support such a constraint.
    """
    if not constraints:
        return method
    if not isinstance(method, Constrained):
        raise UsageError(f"{scope_of(method).sentence_label} takes no fixed, bounded or tied coefficients.")
    return replace(method, constraints={**method.constraints, **constraints.table})


def with_stated(constraints: ConstraintTable, library: ForceLibrary, method: Method) -> Constraints:
    """Add the held coefficients that a user's library states, unless the given constraints contradict.

    Parameters
    ----------
    constraints : mapping of str to float, (float, float) or str
        The given constraints.
    library : ForceLibrary
        The offered forces.
    method : Method
        Method, whose own constraints remain unchanged.
    """
    asked = {*constraints, *getattr(method, "constraints", {})}
    stated = {name: value for name, value in known_coefficients(library).items() if name not in asked}
    return Constraints({**stated, **constraints})


def with_random_force(method: Method, random_force: RandomForceOption) -> Method:
    """Return the method with an option for the random force; unchanged if it has no such option.

    A variant that excludes a random force (the strong form, coloured noise) stays as it is too.

    Parameters
    ----------
    method : Method
        The method without this option.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        See `methods.Trajectory`.

    Raises
    ------
    UsageError
        There is no such option.
    """
    check_random_force(random_force)
    if not is_dataclass(method) or "random_force" not in {option.name for option in fields(method)}:
        return method
    try:
        return replace(method, random_force=random_force)
    except UsageError:
        return method
