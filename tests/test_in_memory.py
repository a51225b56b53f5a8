"""Records in memory: units in names, dates, byte orders; errors; and no silent assumptions."""

import warnings

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.in_memory import as_record

TIME = np.arange(0.0, 8.0, 0.02)
ANGLE = 0.3 * np.exp(-0.09 * TIME) * np.cos(9.0 * TIME)
DEGREES = np.rad2deg(ANGLE)
DATES = pd.date_range("2026-03-29T00:59:56", periods=TIME.size, freq="20ms")


def index(values: object, name: str) -> pd.Index:
    return pd.Index(values, name=name)


SAME = {
    "index in ms": pd.DataFrame({"angle": ANGLE}, index=index(1e3 * TIME, "time (ms)")),
    "index time_ms": pd.Series(ANGLE, index=index(1e3 * TIME, "time_ms")),
    "column in degrees": pd.DataFrame({"angle (deg)": DEGREES}, index=index(TIME, "time (s)")),
    "series in degrees": pd.Series(DEGREES, index=TIME, name="theta [°]"),
    "both in columns": pd.DataFrame({"t [ms]": 1e3 * TIME, "theta_deg": DEGREES, "load": 1.0}),
    "exact names go first": pd.DataFrame({"time": TIME, "angle": ANGLE, "angle (deg)": 0.0 * TIME}),
    "data array": xr.DataArray(DEGREES, {"time (ms)": 1e3 * TIME}, ["time (ms)"], name="angle (deg)"),
    "unit in attrs": pd.Series(DEGREES, index=TIME),
    "universal time": pd.Series(ANGLE, index=DATES.tz_localize("UTC")),
    "a clock that is set": pd.DataFrame(
        {"time": DATES.tz_localize("UTC").tz_convert("Europe/Paris"), "angle": ANGLE}
    ),
    "dates as objects": pd.Series(ANGLE, index=pd.Index(list(DATES.tz_localize("UTC")), dtype=object)),
    "dates as texts": pd.DataFrame({"time": DATES.astype(str), "angle": ANGLE}),
    "other order of bytes": np.c_[TIME, ANGLE].astype(">f8"),
    "matrix": np.c_[TIME, ANGLE].view(np.matrix),
    "numbers that may be missing": pd.DataFrame({"time": TIME, "angle": pd.array(ANGLE, dtype="Float64")}),
}
SAME["unit in attrs"].attrs["units"] = "deg"


@pytest.mark.parametrize("name", SAME)
def test_names_say_units_as_in_files(name: str) -> None:
    record = as_record(SAME[name])
    np.testing.assert_allclose(record.time.values - record.time.values[0], TIME, atol=1e-9)
    np.testing.assert_allclose(record.angle.values.astype(float), ANGLE, atol=1e-12)
    assert record.angle.attrs["units"] == "rad"


def test_a_displacement_keeps_its_unit() -> None:
    assert as_record(pd.DataFrame({"x (mm)": ANGLE}, index=TIME)).angle.attrs["units"] == "mm"


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        (pd.Series(ANGLE), UsageError, "Series has no times: its index counts the rows"),
        (pd.DataFrame({"angle": ANGLE}), UsageError, "DataFrame has no times"),
        (xr.DataArray(ANGLE, dims="time"), UsageError, "DataArray has no times"),
        (pd.Series(ANGLE, index=index(TIME, "time (fortnights)")), UsageError, "'fortnights'"),
        (pd.DataFrame({"omega (rad/s)": ANGLE}, index=TIME), UsageError, "must be integrated"),
        (
            pd.Series(ANGLE, index=index((1e3 * TIME).round().astype(int), "t")),
            RecordError,
            "nothing states the unit of its times: the period would be",
        ),
        (pd.DataFrame({"time": TIME, "t2": TIME, "a": ANGLE, "b": ANGLE}), UsageError, "Name it angle"),
        (
            pd.Series(ANGLE, index=pd.MultiIndex.from_arrays([TIME, TIME])),
            UsageError,
            "several levels",
        ),
    ],
)
def test_ambiguous_data_are_refused(given: object, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        as_record(given)


def test_numbers_of_single_precision_warn_of_nothing() -> None:
    noise = 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)
    record = xr.Dataset({"angle": ("time", (ANGLE + noise).astype(np.float32))}, {"time": TIME})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decay = st.free_decay(record)
        st.identify(decay, st.load_library().select(["zeta"]), st.methods.Direct(random_force="off"))


def test_dates_of_an_input_count_from_the_record_s_first() -> None:
    early = pd.date_range("2026-03-29T00:59:55.900", periods=TIME.size + 20, freq="20ms")
    record = xr.Dataset(
        {"angle": ("time", ANGLE), "u": ("u_time", np.arange(early.size, dtype=float), {"role": "input"})},
        {"time": DATES.to_numpy(), "u_time": early.to_numpy()},
    )
    found = as_record(record)
    assert found.u_time.values[0] == pytest.approx(-0.1)
    mixed = record.assign_coords(u_time=np.arange(early.size) * 0.02)
    with pytest.raises(UsageError, match="time contains dates and u_time none"):
        as_record(mixed)


def run_of(seed: int, kind: str) -> object:
    """An angle over its own times, as an xarray or pandas object."""
    values = ANGLE + 1e-4 * np.random.default_rng(seed).standard_normal(TIME.size)
    if kind == "series":
        return pd.Series(values, index=index(TIME, "time"), name="angle")
    if kind == "dated series":
        return pd.Series(values, index=DATES)
    attrs = {"units": "rad"} if kind == "data array" else {}
    return xr.DataArray(values, {"time": TIME}, ["time"], name="angle", attrs=attrs)


@pytest.mark.parametrize("container", [list, tuple])
@pytest.mark.parametrize("kind", ["data array", "data array without unit", "series", "dated series"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_signals_with_their_own_times_are_runs(container, kind, count):
    runs = st.records.as_decays(container(run_of(seed, kind) for seed in range(count)), "laws")
    assert isinstance(runs, list)
    for seed, found in enumerate(runs):
        wanted = run_of(seed, kind)
        np.testing.assert_array_equal(found.angle.values, np.asarray(wanted))
        np.testing.assert_allclose(found.time.values, TIME, atol=1e-9)


def test_two_rising_angles_with_their_unit_are_runs():
    rising = xr.DataArray(TIME**2, {"time": TIME}, ["time"], name="angle", attrs={"units": "rad"})
    assert len(st.records.as_decays([rising, rising], "laws")) == 2


RECORD = xr.Dataset({"angle": ("time", ANGLE)}, {"time": TIME})
SAMPLES = xr.Dataset({"t": ("sample", TIME), "angle": ("sample", ANGLE)}, {"sample": np.arange(TIME.size)})
LATER = pd.DataFrame({"t": np.append(-1.0, TIME), "angle": np.append(0.0, ANGLE)}).iloc[1:]
PAIRS = {
    "coordinate and variable": (RECORD.time, RECORD.angle),
    "two variables over samples": (SAMPLES.t, SAMPLES.angle),
    "times without a name": (SAMPLES.t.rename(None), SAMPLES.angle.rename(None)),
    "times with a unit alone": (SAMPLES.t.rename(None).assign_attrs(units="s"), SAMPLES.angle),
    "columns of a frame": (LATER.t, LATER.angle),
    "times and a series": (TIME, LATER.angle),
    "dates and angles": (pd.Series(DATES), pd.Series(ANGLE)),
    "index and series": (index(TIME, "time"), run_of(0, "series") * 0.0 + ANGLE),
}


@pytest.mark.parametrize("name", PAIRS)
def test_times_and_angles_are_one_record(name):
    found = st.records.as_decays(PAIRS[name], "laws")
    assert isinstance(found, xr.Dataset)
    np.testing.assert_allclose(found.time.values, TIME, atol=1e-9)
    np.testing.assert_array_equal(found.angle.values, ANGLE)
