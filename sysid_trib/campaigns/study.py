"""Simulated records that are drawn from a description: models, noise, sampling, seeds."""

import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError, RecordError, did_you_mean, readable
from sysid_trib.forces.library import load_library
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.tables import check_is_file
from sysid_trib.simulation.model import Model, check_shapes
from sysid_trib.simulation.simulate import simulate

ANY = -np.inf, np.inf
# Parts of a study and what each may hold: its value where it is left out, and the lowest and highest that may
# be drawn. Names of the first two are in the library.
STUDY_PARTS: dict[str, dict[str, tuple[float | None, tuple[float, float]]]] = {
    "coefficients": {},
    "shapes": {},
    "start": {"angle": (0.3, ANY), "rate": (0.0, ANY)},
    "sampling": {"duration": (None, (1e-9, 1e12)), "rate": (None, (1e-9, 1e12))},
    "noise": {"deviation": (0.0, (0.0, 1e9)), "correlation": (0.0, (-0.999999, 0.999999))},
    "random_force": {"density": (0.0, (0.0, 1e9))},
}
STUDY_MOTION = {"reference_frequency": (None, (1e-9, 1e9))}
TOP = ("title", "records", "seed", "library", *STUDY_MOTION, *STUDY_PARTS)
DRAWN = {"low", "high"}, {"mean", "deviation"}
LONGEST_RECORD = 10_000_000
SAMPLES_ALLOWED = f"duration times rate must be 2 to {LONGEST_RECORD:,} samples"


@dataclass(frozen=True)
class Study:
    """Simulated records by their number.

    Parameters
    ----------
    title : str
    records : int
        How many there are.
    seed : int
        Of the study; that of each record follows from it and from the record's number alone.
    library : str
        Name or file of the forces.
    values : mapping
        What is drawn for each record: a number, a list to choose from, {low, high} of a uniform law, or
        {mean, deviation} of a normal one. By part and name: `{"coefficients": {"lambda": ...}, ...}`.

    Notes
    -----
    Coefficients are dimensionless, or in their force's unit, at `reference_frequency` (rad/s). `start` has
    `angle` (rad) and `rate` (rad/s), `sampling` has `duration` (s) and `rate` (Hz), `noise` has `deviation`
    (rad) and `correlation` (of an autoregression of first order, 0 if left out), `random_force` has `density`
    ((rad/s^2)^2/Hz).
    """

    title: str
    records: int
    seed: int
    library: str
    values: Mapping[str, Mapping[str, Any]]

    def __len__(self) -> int:
        return self.records

    def drawn(self, at: int) -> dict[str, dict[str, float]]:
        """All values of a record, by part and name."""
        random = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(at,)))
        drawn: dict[str, dict[str, float]] = {
            part: {name: value for name, (value, _) in of.items() if value is not None}
            for part, of in STUDY_PARTS.items()
        }
        for part, names in self.values.items():
            drawn.setdefault(part, {}).update({k: _draw(value, random) for k, value in names.items()})
        return drawn

    def decay(self, at: int) -> xr.Dataset:
        """A record, as far as its motion goes on.

        Raises
        ------
        SimulationError
            The motion of these values cannot be computed.
        DecayError
            It is no decay, or too long.
        """
        drawn = self.drawn(at)
        start, sampling, noise = drawn["start"], drawn["sampling"], drawn["noise"]
        library, frequency = load_library(self.library), drawn["motion"]["reference_frequency"]
        library = library.select(drawn["coefficients"])
        model = Model(library, drawn["coefficients"], frequency, drawn["shapes"])
        samples = sampling["duration"] * sampling["rate"]
        if not 1.0 < samples <= LONGEST_RECORD:
            raise DecayError(f"{samples:.6g} samples were drawn; {SAMPLES_ALLOWED}.")
        time = np.arange(round(samples)) / sampling["rate"]
        # One stream for what is drawn, one for the noise, one for the random force.
        noisy, forced = np.random.SeedSequence(self.seed, spawn_key=(at, 1)).spawn(2)
        density, seed = drawn["random_force"]["density"], int(forced.generate_state(1)[0])
        motion = simulate(model, time, start["angle"], start["rate"], random_force=density, seed=seed)
        white = np.random.default_rng(noisy).standard_normal(len(time))
        angle = motion["angle"].values + noise["deviation"] * _coloured(white, noise["correlation"])
        attrs = {"source": f"record {at} of {self.title}", "synthetic": "drawn from a study"}
        at_time = ("time", time, {"units": "s"})
        return free_decay(xr.Dataset({"angle": ("time", angle, {"units": "rad"})}, {"time": at_time}, attrs))


# Files, decays in memory, or simulated records.
CampaignRecords: TypeAlias = Sequence[str | os.PathLike[str] | xr.Dataset] | Study


def names_of(records: CampaignRecords) -> list[str]:
    """The names that records have in a store."""
    if isinstance(records, Study):
        return [str(at) for at in range(len(records))]
    named = (
        item.attrs.get("source", f"record {at}") if isinstance(item, xr.Dataset) else item
        for at, item in enumerate(records)
    )
    return [readable(str(name)) for name in named]


def record_at(records: CampaignRecords, at: int) -> Any:
    """A record as `rows_of` takes it."""
    if isinstance(records, Study):
        return records, int(at)
    item = records[at]
    return item if isinstance(item, xr.Dataset) else os.fspath(item)


def _coloured(white: np.ndarray, correlation: float) -> np.ndarray:
    """Autoregressive noise of first order with unit variance."""
    from scipy.signal import lfilter

    innovation = np.sqrt(1.0 - correlation**2) * white
    return np.asarray(lfilter([1.0], [1.0, -correlation], innovation, zi=[correlation * white[0]])[0])


def _draw(value: Any, random: np.random.Generator) -> float:
    """A number, one of a list, or of a law."""
    if isinstance(value, Mapping):
        if "low" in value:
            return float(random.uniform(value["low"], value["high"]))
        return float(random.normal(value["mean"], value["deviation"]))
    if isinstance(value, list | tuple):
        return float(value[random.integers(len(value))])
    return float(value)


def load_study(path: str | os.PathLike[str]) -> Study:
    """Read a study from TOML.

    Parameters
    ----------
    path : path-like
        See `Study` for what it holds.

    Returns
    -------
    Study

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        It is no TOML, lacks a part, or holds what a study has no place for.
    """
    name = Path(path).name
    check_is_file(Path(path))
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RecordError(f"{name}: not a study in TOML ({error}).") from None
    _refuse_unknown(data, TOP, f"{name}: a study")
    if lacking := [key for key in (*STUDY_MOTION, "coefficients", "sampling") if key not in data]:
        raise RecordError(f"{name}: a study needs '{lacking[0]}'.")
    values = {"motion": {key: data[key] for key in STUDY_MOTION}}
    values |= {part: data[part] for part in STUDY_PARTS if part in data}
    for part, table in values.items():
        if not isinstance(table, Mapping) or not table:
            raise RecordError(f"{name}: '{part}' must be a table of values.")
        known = STUDY_PARTS.get(part, STUDY_MOTION)
        _refuse_unknown(table, known or table, f"{name}: '{part}'")
        for key, value in table.items():
            _check(value, known[key][1] if key in known else ANY, f"{name}: '{key}' of '{part}'")
    records, seed = data.get("records", 100), data.get("seed", 0)
    if not all(isinstance(count, int) and 0 <= count < 2**63 for count in (records, seed)) or not records:
        raise RecordError(f"{name}: 'records' and 'seed' must be whole numbers, the first above zero.")
    if lacking := [key for key in STUDY_PARTS["sampling"] if key not in values["sampling"]]:
        raise RecordError(f"{name}: 'sampling' needs '{lacking[0]}'.")
    library = str(data.get("library", "contact_forces"))
    study = Study(str(data.get("title", Path(path).stem)), records, seed, library, values)
    sampling = study.drawn(0)["sampling"]
    if not 1.0 < sampling["duration"] * sampling["rate"] <= LONGEST_RECORD:
        raise RecordError(f"{name}: {SAMPLES_ALLOWED}.")
    check_shapes(values.get("shapes", {}), load_library(library).select(values["coefficients"]))
    return study


def _refuse_unknown(given: Iterable[str], known: Iterable[str], what: str) -> None:
    """Refuse a name that would be passed over in silence."""
    for key in given:
        if key not in known:
            raise RecordError(f"{what} has no '{key}'; it has {', '.join(known)}.{did_you_mean(key, known)}")


def _check(value: Any, allowed: tuple[float, float], what: str) -> None:
    """Refuse what cannot be drawn, or what no record can have."""
    law = isinstance(value, Mapping) and set(value) in DRAWN
    numbers = list(value.values()) if law else value if isinstance(value, list) and value else [value]
    good = all(isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < 1e12 for n in numbers)
    if not good or (law and "low" in value and not value["low"] <= value["high"]):
        raise RecordError(
            f"{what} must be a number, a list of numbers, {{low = ..., high = ...}} or "
            "{mean = ..., deviation = ...}."
        )
    normal = law and "mean" in value
    if normal and value["deviation"] < 0.0:
        raise RecordError(f"{what}: the deviation of what is drawn must not be below zero.")
    # A normal law has no bounds: what it draws is refused record by record.
    low, high = allowed
    if not all(low <= n <= high for n in ([value["mean"]] if normal else numbers)):
        raise RecordError(f"{what} must be from {low:g} to {high:g}.")
