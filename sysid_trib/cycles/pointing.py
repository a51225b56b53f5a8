"""Forces and system indicated by the backbone of a decay: models ranked by their predictions.

Each model is fitted to four fifths of a curve and predicts the remaining fifth, for each fifth in turn. Small
amplitudes have less weight: friction that yields elastically bends the curve there, which says little about
the motion as a whole.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import xarray as xr
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import lsq_linear, minimize_scalar, nnls

from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import backbone, half_width
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import with_shipped
from sysid_trib.forces.systems import System, load_systems
from sysid_trib.records import half_sines
from sysid_trib.results.signal_scale import counts_angles

# Forces by formula, because symbols differ between libraries; and their names in words.
FRICTION = {"sign(v)": "dry friction", "2*v": "viscous friction", "v*abs(v)": "quadratic drag"}
ELASTIC = {"x*abs(x)": "a quadratic spring", "x**3": "a cubic spring"}
VISCOUS_FORMULA = "2*v"
USUAL_LIBRARY = "contact_forces"

FOLDS = 5
# Least relative error of an average over a cycle, for a curve and for its change.
PRECISION = 0.02
# A model with more forces must predict better by this factor. Models within the errors of a curve predict it
# equally well.
BETTER_BY, WITHIN_ERRORS = 1.1, 1.0
# A system with a held elastic force has no coefficient to fit. Its residual may be the first fraction of the
# frequency change; or up to the second, if free coefficients reduce it by less than this factor.
HELD_REMAINS, HELD_REMAINS_MOST, HELD_OVER_FREE = 0.1, 0.25, 2.5
# Relative error of the frequency shift due to third harmonics of a pendulum and an elastic string.
OPEN_SHIFT = 0.1
# A scale within these limits counts if it exceeds its errors by this factor and reduces the residual of the
# pendulum to this fraction.
SCALE_LIMITS, SCALE_ERRORS, SCALE_REMAINS = (0.87, 1.15), 4.0, 0.5
# Phases of a quarter of a swing, for the integral of its period.
PHASES = (np.arange(400) + 0.5) * (0.5 * np.pi / 400)
# Range of the largest displacements of computed swings, over the largest amplitude.
PEAKS, PEAK_COUNT = (0.004, 1.4), 300


@dataclass(frozen=True)
class ElasticModel:
    """Elastic forces that explain how the frequency changes with amplitude.

    Attributes
    ----------
    free : tuple of Force
        Forces whose coefficients are fitted.
    held : tuple of (Force, float)
        Forces whose coefficients are known.
    systems : tuple of str
        Systems that have these elastic forces, and no others.
    remains : float
        Residual of the predicted parts, over that of a constant.
    errors : float
        Errors of the curve in the same measure; smaller residuals do not distinguish models.
    within_band : bool
        True if the model stays within the band of the curve, apart from the error of averages.
    scale : Scale or None
        Factor on the signal with which fixed forces predict much better; None if there is no such factor.
    """

    free: tuple[Force, ...]
    held: tuple[tuple[Force, float], ...]
    systems: tuple[str, ...]
    remains: float = np.nan
    errors: float = 0.0
    within_band: bool = False
    scale: "Scale | None" = None

    @property
    def words(self) -> str:
        """Forces in words."""
        elastic = [_elastic_words(force) for force in self.free]
        return _listed([*(f"{force.name} alone" for force, _ in self.held), *elastic])


@dataclass(frozen=True)
class Scale:
    """A factor on the signal, its error, and the prediction residual with this factor."""

    factor: float
    error: float
    remains: float


@dataclass(frozen=True)
class Pointed:
    """Forces and system that a backbone indicates.

    Attributes
    ----------
    forces : tuple of str
        Symbols of the forces that improve the prediction of the curves.
    system : str
        The name of the system; empty if several systems have these forces and the columns of the file do not
        decide.
    words : str
        Both in words.
    columns : str
        The columns that identify the file as one of the system; empty if the backbone decides.
    ranking : tuple of ElasticModel
        Models of the frequency: first the chosen one, then by their predictions; empty if the frequency is
        constant.
    scale : Scale or None
        Factor by which the signal must be multiplied so that the system fits; None if it fits, or no factor
        helps.
    """

    forces: tuple[str, ...] = ()
    system: str = ""
    words: str = ""
    columns: str = ""
    ranking: tuple[ElasticModel, ...] = ()
    scale: Scale | None = None


def pointed_to(decay: xr.Dataset) -> Pointed:
    """Return the forces and the system that the backbone of a record indicates.

    Parameters
    ----------
    decay : Dataset
        ``angle(time)``; its attrs may name the columns of its file.

    Returns
    -------
    Pointed
        Forces and system; from the columns alone if there are too few half periods for a backbone.

    Notes
    -----
    Viscous friction is always included. Dry friction and drag are named if they improve the prediction of the
    damping ratio. The frequency indicates nothing if a constant stays within its band. Otherwise each system
    of `libraries/systems.toml` predicts the frequency with its elastic forces. Forces that the system holds,
    such as a pendulum's gravity, have no coefficient to fit.
    """
    try:
        curves = backbone(decay)
    except DecayError:
        return _by_columns(decay)
    library = load_library(USUAL_LIBRARY)
    # Noise, or the spectral line of another motion, shifts the mean frequency of many periods, and their
    # decrements, by the square of its relative amplitude; averaging does not remove this.
    part = np.square(_scatter(decay, curves))
    friction = _friction(curves, library, part)
    words = [FRICTION[formula] for formula in friction]
    parts = [f"the decay looks like {' plus '.join(words)}"] if words else []
    symbols = [force.symbol for formula in friction if (force := library.role(formula)) is not None]
    ranking = _ranking(curves, part, angle=counts_angles(decay))
    chosen, scale, pointed = _chosen(ranking), None, _by_columns(decay)
    if chosen is not None and chosen.held:
        system = chosen.systems[0]
        pointed = Pointed(system=system)
        held = _listed([force.name for force, _ in chosen.held])
        parts.append(f"the frequency shift looks like that of a {system} ({held})")
        scale = chosen.scale
    elif chosen is not None:
        symbols += [force.symbol for force in chosen.free]
        parts.append(f"the frequency shift looks like {chosen.words}")
    ordered = tuple(sorted(ranking, key=lambda model: model is not chosen))
    pointed = replace(pointed, forces=tuple(symbols), words="; ".join(parts))
    return replace(pointed, ranking=ordered, scale=scale)


def _by_columns(decay: xr.Dataset) -> Pointed:
    """Return the system that the columns of the file name, with these columns; else nothing."""
    attrs = decay.attrs
    signal, names = str(attrs.get("angle_column", "")), str(attrs.get("columns_in_file", "")).split("; ")
    for system in load_systems().values():
        if columns := system.known_columns(signal, names):
            return Pointed(system=system.name, columns=_listed(columns))
    return Pointed()


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _errors(a: Array, error: Array, size: Array | float) -> Array:
    """Return the errors of a curve for a fit that gives large amplitudes more weight."""
    return np.hypot(error, PRECISION * np.abs(size)) * (a[-1] / a)


def _score(
    columns: Sequence[Array], curve: Array, error: Array, fit: Callable[[Array, Array], Array]
) -> float:
    """Return the RMS, in errors, of predicting each part of a curve from a fit to the other parts."""
    table = np.column_stack(columns) / error[:, None]
    target = curve / error
    squares = []
    for held in np.array_split(np.arange(len(curve)), FOLDS):
        kept = np.delete(np.arange(len(curve)), held)
        weights = fit(table[kept], target[kept])
        squares.append(np.mean((table[held] @ weights - target[held]) ** 2))
    return float(np.sqrt(np.mean(squares)))


def _positive(table: Array, target: Array) -> Array:
    return np.asarray(nnls(table, target)[0])


def _free(table: Array, target: Array) -> Array:
    return np.asarray(lsq_linear(table, target).x)


def _fewest(scores: Mapping[tuple[str, ...], float]) -> tuple[str, ...]:
    """Return the fewest forces that predict as well as the best ones."""
    best = max(min(scores.values()), WITHIN_ERRORS)
    good = [names for names, score in scores.items() if score <= BETTER_BY * best]
    return min(good, key=lambda names: (len(names), scores[names]))


# Number of extrema for the median of the scatter, for the local mean, and the least number for a local mean.
NEIGHBOURING_EXTREMA, LOCAL, FEWEST_FOR_LOCAL = 9, 41, 400


def _scatter(decay: xr.Dataset, curves: xr.Dataset) -> Array:
    """Return the scatter of a single extremum over its size, at the amplitudes of a backbone."""
    measured = half_sines.envelope(decay)
    size = measured.extremum.values
    order = np.argsort(size)
    relative = measured.extremum_standard_error.values / size
    if size.size >= FEWEST_FOR_LOCAL:
        off = np.log(size) - uniform_filter1d(np.log(size), LOCAL)
        relative = np.maximum(relative, np.sqrt(uniform_filter1d(off**2, LOCAL)))
    relative = median_filter(relative[order], NEIGHBOURING_EXTREMA)
    return np.asarray(np.interp(curves.amplitude.values, size[order], relative))


def _friction(curves: xr.Dataset, library: ForceLibrary, part: Array) -> list[str]:
    """Return the formulas of the friction that the damping ratio indicates; empty if it is too uncertain.

    `part` : relative shift of both curves that the square of the noise may cause.
    """
    a, ratio = curves.amplitude.values, curves.damping_ratio.values
    frequency = curves.frequency.values
    # Decrements are proportional to the square of the period, which first-order averages neglect.
    shift = np.abs(frequency - np.average(frequency, weights=half_width(curves, "frequency") ** -2.0))
    width = half_width(curves, "damping_ratio") + 2.0 * (shift / frequency + part) * np.abs(ratio)
    # A curve whose smallest relative error exceeds this contains too little information.
    if not np.min(width / np.abs(ratio)) < 0.5:
        return []
    roles = {formula: library.role(formula) for formula in FRICTION}
    columns = {f: -averages(force, a, {})[0] / a for f, force in roles.items() if force is not None}
    known = np.hypot(curves.damping_ratio_standard_error.values, 2.0 * part * ratio)
    error = _errors(a, known, ratio)
    others = [formula for formula in columns if formula != VISCOUS_FORMULA]
    scores = {
        names: _score([columns[VISCOUS_FORMULA], *(columns[name] for name in names)], ratio, error, _positive)
        for count in range(len(others) + 1)
        for names in combinations(others, count)
    }
    chosen = [formula for formula in columns if formula in (VISCOUS_FORMULA, *_fewest(scores))]
    table = np.column_stack([columns[formula] for formula in chosen]) / error[:, None]
    weights = _positive(table, ratio / error)
    return [formula for formula, weight in zip(chosen, weights, strict=True) if weight]


def _elastic_models(systems: Iterable[System]) -> list[ElasticModel]:
    """Return the elastic forces of freely swinging systems, and each subset of their fitted forces."""
    models: dict[tuple[str, ...], ElasticModel] = {}
    for system in systems:
        library = with_shipped(load_library(USUAL_LIBRARY), system.symbols)
        forces = [library[symbol] for symbol in system.symbols]
        # Driven systems, and bodies without a restoring force, have no backbone.
        if any(force.inputs or force.matches("-x") for force in forces):
            continue
        elastic = [force for force in forces if force.character == "conservative"]
        held = tuple((force, system.held[force.symbol]) for force in elastic if force.symbol in system.held)
        free = [force for force in elastic if force.symbol not in system.held]
        for count in range(len(free) + 1):
            for part in combinations(free, count):
                key = (*(force.symbol for force, _ in held), *(force.symbol for force in part))
                known = models.get(key, ElasticModel(part, held, ()))
                names = (system.name,) if count == len(free) else ()
                models[key] = replace(known, systems=(*known.systems, *names))
    return [model for model in models.values() if model.free or model.held]


def free_swings(held: Iterable[tuple[Force, float]], peak: Array) -> tuple[Array, Array]:
    """Return the exact frequency of free swings over that of small ones, and their first harmonic.

    Parameters
    ----------
    held : iterable of (Force, float)
        Odd conservative forces, and their coefficients.
    peak : (peak,) array of float
        Largest displacements.

    Returns
    -------
    frequency, harmonic : (peak,) array of float
        nan if the motion does not return.
    """
    x = peak[:, None] * np.sin(PHASES)
    speed = peak[:, None] * np.cos(PHASES)
    step = PHASES[1] - PHASES[0]
    # Integrate the potential in dx/dtau = sqrt(2 (V(peak) - V(x))) from the peak downwards.
    slope = (x + sum(value * force.value(x, np.zeros_like(x)) for force, value in held)) * speed
    below = np.cumsum(slope[:, ::-1], axis=1)[:, ::-1] * step - 0.5 * slope * step
    with np.errstate(all="ignore"):
        time = speed / np.sqrt(2.0 * below) * step
    frequency = 0.5 * np.pi / np.sum(time, axis=1)
    turn = frequency[:, None] * time
    phase = np.cumsum(turn, axis=1) - 0.5 * turn
    return frequency, np.sum(x * np.sin(phase) * turn, axis=1) * 4.0 / np.pi


def held_frequency(held: Iterable[tuple[Force, float]], a: Array) -> Array:
    """Return the frequency of free swings over that of small ones, by the amplitude of a half-sine.

    Parameters
    ----------
    held : iterable of (Force, float)
        Forces as `free_swings` takes them.
    a : (amplitude,) array of float
        Increasing amplitudes, as in a backbone.
    """
    peaks = np.linspace(*PEAKS, PEAK_COUNT) * a[-1]
    frequency, harmonic = free_swings(held, peaks)
    moves = np.isfinite(frequency)
    if not moves.any():
        return np.full_like(a, np.nan)
    return np.interp(a, harmonic[moves], frequency[moves], left=1.0, right=np.nan)


def _ranking(curves: xr.Dataset, part: Array, *, angle: bool) -> tuple[ElasticModel, ...]:
    """Return models of the frequency, the best prediction first; none if a constant stays within the band.

    `part` : relative shift of the frequency that the square of the noise may cause.
    """
    a, frequency = curves.amplitude.values, curves.frequency.values
    half = half_width(curves, "frequency") + part * frequency
    known = np.hypot(curves.frequency_standard_error.values, part * frequency)
    constant = np.ones_like(a)
    if _deviation([constant], frequency, half) <= 1.0:
        return ()
    shift = np.abs(frequency - np.average(frequency, weights=half**-2.0))
    # The square of the frequency is linear in the coefficients (harmonic balance).
    error = 2.0 * frequency * _errors(a, known, _change(a, frequency))
    least = _score([constant], frequency**2, error, _free)
    ranked = []
    for model in _elastic_models(load_systems().values()):
        if model.held and not angle:
            continue
        swing = held_frequency(model.held, a)
        if np.all(np.isfinite(swing)):
            columns = [swing**2, *(2.0 * averages(force, a, {})[1] / a for force in model.free)]
            remains = _score(columns, frequency**2, error, _free) / least
            within = not model.free and _deviation([swing], frequency, half + OPEN_SHIFT * shift) <= 1.0
            scale = _scale(curves, model.held, least) if model.held and not model.free else None
            errors = WITHIN_ERRORS / least
            fitted = replace(model, remains=remains, errors=errors, within_band=within, scale=scale)
            ranked.append(fitted)
    return tuple(sorted(ranked, key=lambda model: (model.remains, len(model.free))))


def _change(a: Array, frequency: Array) -> float:
    """Return the RMS change of the frequency with amplitude, weighted towards large amplitudes."""
    middle = np.average(frequency, weights=a**2)
    return float(np.sqrt(np.average((frequency - middle) ** 2, weights=a**2)))


def _deviation(columns: Sequence[Array], curve: Array, half: Array) -> float:
    """Return the largest deviation of the best sum from a curve, in half widths of its band."""
    table = np.column_stack(columns) / half[:, None]
    return float(np.max(np.abs(table @ _free(table, curve / half) - curve / half)))


def _elastic_words(force: Force) -> str:
    return next((words for formula, words in ELASTIC.items() if force.matches(formula)), force.name)


def _chosen(ranking: Sequence[ElasticModel]) -> ElasticModel | None:
    """Choose the model of the frequency: a system that contains its force, or the fewest free forces."""
    free = [model for model in ranking if not model.held]
    least = min((model.remains for model in free), default=np.inf)
    known = next((model for model in ranking if model.held and _fits(model, least)), None)
    if known is not None:
        return known
    # A model without forces predicts as a constant does.
    good = [
        model for model in free if model.remains <= min(1.0 / BETTER_BY, BETTER_BY * max(least, model.errors))
    ]
    return min(good, key=lambda model: (len(model.free), model.remains), default=None)


def _fits(model: ElasticModel, least: float) -> bool:
    """Return true if held forces explain the frequency, with or without a scale of the signal.

    Parameters
    ----------
    model : ElasticModel
    least : float
        Residual of the best model with free coefficients.
    """
    if model.within_band or model.remains <= max(
        HELD_REMAINS, min(HELD_REMAINS_MOST, HELD_OVER_FREE * least)
    ):
        return True
    if model.scale is None or model.remains > HELD_REMAINS_MOST:
        return False
    return model.scale.remains <= HELD_OVER_FREE * max(least, model.errors)


def _scale(curves: xr.Dataset, held: Sequence[tuple[Force, float]], least: float) -> Scale | None:
    """Return the factor on the signal with which held forces predict the frequency.

    Parameters
    ----------
    curves : Dataset
        Result of `backbone`.
    held : sequence of (Force, float)
        The forces, and their coefficients.
    least : float
        Score of a constant frequency.

    Returns
    -------
    Scale or None
        None if the forces predict as well without a factor, or badly with any factor.
    """
    a, frequency = curves.amplitude.values, curves.frequency.values
    error = _errors(a, curves.frequency_standard_error.values, _change(a, frequency))

    def score(factor: float) -> float:
        swing = held_frequency(held, factor * a)
        return _score([swing], frequency, error, _free) if np.all(np.isfinite(swing)) else np.inf

    best = minimize_scalar(score, bounds=SCALE_LIMITS, method="bounded", options={"xatol": 1e-4})
    factor, deviation = float(best.x), max(float(best.fun), WITHIN_ERRORS)
    if deviation > SCALE_REMAINS * score(1.0) or min(abs(factor - end) for end in SCALE_LIMITS) < 1e-3:
        return None
    # Derivative of the frequency by the factor.
    nearby = (held_frequency(held, end * factor * a) for end in (0.99, 1.01))
    slope = np.subtract(*nearby) / (0.02 * factor) * np.max(frequency)
    slope -= np.average(slope, weights=error**-2.0)
    # The points of a smooth curve count as `FOLDS` independent values.
    uncertainty = float(deviation / np.sqrt(FOLDS * np.mean((slope / error) ** 2)))
    if abs(factor - 1.0) < SCALE_ERRORS * uncertainty:
        return None
    return Scale(factor, uncertainty, float(best.fun) / least)
