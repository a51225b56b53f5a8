"""Residuals of formulas, and of laws, on a held-out part of the record."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import root_mean_square
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import library_of_text
from sysid_trib.methods.scope import Method
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.law_curves import NAME_IN_FORMULAS, VARIABLE_OF_LAW
from sysid_trib.results.variables import described
from sysid_trib.smooth_laws.fits import LawFit
from sysid_trib.validation import holdout


def with_predictions(listed: Mapping[str, xr.Dataset], fit: LawFit) -> dict[str, xr.Dataset]:
    """Add to the formulas of each law their residuals on the last third of the runs.

    Parameters
    ----------
    listed : mapping of str to Dataset
        Results of `law_formulas`, by law.
    fit : LawFit
        Fit of the laws.

    Returns
    -------
    dict of str to Dataset
        With `held_out_rms(alternative)` and `held_out_rms_of_laws` (rad): each model is identified from the
        first two thirds and predicts the rest, with fitted start and zero. A formula is combined with the
        first formula of the other law, or with its curve if there is none.
    """
    runs = list(fit.followed.runs.values())
    if not any(formulas.sizes["alternative"] for formulas in listed.values()):
        return dict(listed)
    of_laws = held_out_rms(runs, fit.asked_method, fit.library)
    first = {law: next(_forces_of(formulas), None) for law, formulas in listed.items()}
    predicted, known = {}, dict[frozenset[str], float]()
    for law, formulas in listed.items():
        (other,) = (name for name in VARIABLE_OF_LAW if name != law)
        missed = []
        for forces in _forces_of(formulas):
            library = _model(fit, {law: forces, other: first.get(other)})
            # The first formulas of both laws form one model.
            key = frozenset(force.symbol + force.formula.text for force in library)
            if key not in known:
                kept = {
                    name: value for name, value in fit.method.constraints.items() if name in library.symbols
                }
                known[key] = held_out_rms(runs, replace(fit.method, constraints=kept), library)
            missed.append(known[key])
        values = {"held_out_rms": missed, "held_out_rms_of_laws": of_laws}
        predicted[law] = formulas.assign(described("law_formulas", values))
    return predicted


def held_out_rms(runs: Sequence[xr.Dataset], method: Method, library: ForceLibrary) -> float:
    """Return the RMS residual (rad) of the last third for a model of the rest; nan without a motion."""
    try:
        result = method.identify(one_or_all([holdout.split(run)[0] for run in runs]), library)
        motions = holdout.motions_held_out(result, runs)
    except (SysidTribError, np.linalg.LinAlgError):
        return float("nan")
    if any(motion is None for motion in motions):
        return float("nan")
    rests = [holdout.split(run)[1].angle.values for run in runs]
    pairs = zip(rests, motions, strict=True)
    missed = [angle - motion.offset - motion.x for angle, motion in pairs if motion is not None]
    return float(root_mean_square([root_mean_square(residual) for residual in missed]))


def _forces_of(formulas: xr.Dataset) -> Iterator[list[Force]]:
    """Yield the forces of each formula."""
    if not formulas.sizes["alternative"]:
        return
    library = library_of_text(formulas.attrs["library"], "formulas")
    for coefficients in formulas.coefficient.values:
        symbols = formulas.force.values[np.isfinite(coefficients)].tolist()
        yield [library[symbol] for symbol in symbols]


def _model(fit: LawFit, forces: Mapping[str, Sequence[Force] | None]) -> ForceLibrary:
    """Return the forces of a fit in which formulas replace laws."""
    replaced = {NAME_IN_FORMULAS[VARIABLE_OF_LAW[law]] for law, of_law in forces.items() if of_law}
    kept = [force for force in fit.library if not any(force.depends_only_on(of) for of in replaced)]
    taken = {force.symbol for force in kept}
    for of_law in forces.values():
        for force in of_law or ():
            kept.append(
                replace(force, symbol=f"{force.symbol}_of_formula" if force.symbol in taken else force.symbol)
            )
            taken.add(kept[-1].symbol)
    return replace(fit.library, title="Formulas", forces=tuple(kept))
