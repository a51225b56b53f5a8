"""Searches and comparisons of driven records, by the same functions as for decays."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.discovery.engine.start_model import fit_start_model
from sysid_trib.discovery.unseen import search_parts
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.records.inputs import KnownInput
from sysid_trib.records.smoothing import first_frequency
from sysid_trib.results.judged import record_noise

W, NOISE = 9.9, 2e-4
INPUTS, CONTACT = st.load_library("inputs"), st.load_library("contact_forces")
TRUTH = {"gain": 0.05, "zeta": 0.01, "epsilon": -0.1}


def library(with_input: str, others: str) -> ForceLibrary:
    return replace(INPUTS, forces=(*INPUTS.select(with_input.split()), *CONTACT.select(others.split())))


def record(truth: dict[str, float], name: str = "u", seconds: float = 25.0, units: str = "N*m") -> xr.Dataset:
    """A record under tones about the resonance, with white noise."""
    rng, time = np.random.default_rng(1), np.arange(0.0, seconds, 0.03)
    tones = np.outer(time, W * np.linspace(0.1, 2.0, 40)) + rng.uniform(0.0, 6.28, 40)
    known = KnownInput(time, np.cos(tones).sum(axis=1) / 4.5, "linear")
    whole = replace(INPUTS, forces=(*INPUTS, *CONTACT))
    forces = whole.select(s for s in whole.symbols if s in truth)
    motion = st.simulate(st.Model(forces, truth, W), time, 0.1, inputs={name: known})
    return xr.Dataset(
        {
            "angle": ("time", motion.angle.values + NOISE * rng.standard_normal(len(time)), {"units": "rad"}),
            name: ("time", known.values, {"units": units, "role": "input", "between": "linear"}),
        },
        {"time": time},
    )


@pytest.fixture(scope="module")
def driven() -> xr.Dataset:
    return record(TRUTH)


@pytest.mark.slow
def test_a_search_starts_with_the_inputs_and_finds_the_cubic_spring(driven):
    tree = st.discover(driven, max_effects=1)
    assert tree["before"].force.values.tolist() == ["gain", "zeta"]
    assert tree["steps"].symbol.values.tolist() == ["epsilon"]
    assert tree.attrs["search_outcome"] == "explained"
    # The noise of a driven motion cannot be estimated by a spline: the text states the residual and that it
    # is white.
    said = verdict_sentences(tree)[0]
    assert said.startswith("Explained: with epsilon the residual is 0.")
    assert "% of the motion (RMS), and white. Neither the candidates nor the omnibus test" in said
    assert record_noise(tree) == pytest.approx(NOISE, rel=0.1)
    after = tree["after"].to_dataset()
    for symbol, true in TRUTH.items():
        found = after.sel(force=symbol)
        assert abs(found.coefficient.item() - true) < 4.0 * found.standard_error.item()
    before, last = tree["holdout"].rms.values
    assert last < 0.05 * before


@pytest.mark.parametrize(("push", "units"), [("input", "rad/s^2"), ("u", "N*m")])
def test_an_acceleration_pushes_as_a_force_with_its_gain_does(push, units):
    acceleration = {"gain": 0.05} if push == "u" else {}
    known = record({**acceleration, "zeta": 0.01}, push, units=units)
    fitted = fit_start_model([known], library("gain" * (push == "u"), "zeta").forces, None)
    assert fitted.coefficients[-1] == pytest.approx(0.01, abs=1e-4)
    assert fitted.rows[0].path.frequency == pytest.approx(W, rel=1e-4)


def test_friction_on_a_moving_surface_switches_where_the_surface_is_overtaken():
    moving = record({"surface_friction": 0.01, "zeta": 0.01}, "surface", units="rad")
    fitted = fit_start_model([moving], library("surface_friction", "zeta").forces, None)
    assert fitted.coefficients == pytest.approx([0.01, 0.01], rel=0.05)


def test_a_long_driven_record_is_searched_in_stretches_and_a_decay_is_not():
    long = record(TRUTH, seconds=400.0)
    _, learnt, later = search_parts([long], [], 60)
    time, last = long.time.values, learnt[-1].record.time.values[-1]
    assert (len(learnt), len(later)) == (3, 3)
    assert last <= time[0] + 2.0 / 3.0 * np.ptp(time) < later[0].record.time.values[0] + 1e-9
    assert all(part.origin == time[0] for part in learnt)
    assert len(search_parts([long.drop_vars("u")], [], 60)[1]) == 1


@pytest.mark.parametrize(
    ("forces", "said"),
    [
        (library("gain base_spring", "zeta"), "which this record lacks"),
        (library("gain free_axis", "zeta"), "needs a restoring force, and this body has none"),
    ],
)
def test_requests_that_a_search_does_not_support_are_refused(driven, forces, said):
    held = {"free_axis": 1.0} if "free_axis" in forces.symbols else {}
    with pytest.raises(UsageError, match=said):
        st.discover(driven, forces, constraints=held)


def test_methods_of_inputs_stand_side_by_side_and_the_others_say_why_not(driven):
    methods = [st.methods.Direct(), st.methods.Trajectory(), st.methods.Averaging()]
    table = st.compare(driven, library("gain", "zeta epsilon"), methods)["comparison"].to_dataset()
    for label in ("direct", "trajectory"):
        row = table.sel(model=label)
        assert row.coefficient.sel(force="gain").item() == pytest.approx(0.05, rel=1e-3)
        assert row.holdout_over_noise.item() < 1.2
    assert "takes free decays alone" in table.sel(model="averaging").reason.item()
    assert table.white_residual


def on_a_belt(friction: float, speed: float) -> xr.Dataset:
    """A mass that a force pushes on a belt: it sticks to the belt, and overtakes it."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 19.0, 2.0 * np.pi / W / 40)
    push = KnownInput(time, np.cos(np.outer(time, W * np.array([0.8, 0.95, 1.1]))).sum(axis=1), "linear")
    belt = KnownInput(time, speed * W * time, "linear")
    forces = library("gain surface_friction", "zeta")
    truth = {"gain": 0.03, "surface_friction": friction, "zeta": 0.01}
    clean = st.simulate(st.Model(forces, truth, W), time, 0.05, inputs={"u": push, "surface": belt})
    angle = clean.angle.values + NOISE * rng.standard_normal(len(time))
    columns = {"angle": (angle, ""), "u": (push.values, "linear"), "surface": (belt.values, "linear")}
    record = xr.Dataset({name: ("time", values) for name, (values, _) in columns.items()}, {"time": time})
    for name, (_, between) in columns.items():
        role = {"role": "input", "between": between} if between else {}
        record[name].attrs |= {"units": "N" if name == "u" else "rad"} | role
    return record


def test_while_a_mass_sticks_to_a_belt_its_friction_is_a_reaction_and_says_nothing():
    belt = on_a_belt(friction=0.05, speed=0.03)
    fitted = fit_start_model([belt], library("gain surface_friction", "zeta").forces, None)
    assert 0.05 < fitted.rows[0].path.sticking.mean() < 0.7
    errors = np.sqrt(np.diag(fitted.likelihood.covariance))[:3]
    assert np.all(np.abs(fitted.coefficients - [0.03, 0.05, 0.01]) < 4.0 * errors)
    assert np.all(errors < 0.05 * fitted.coefficients)


def test_a_mass_displaced_by_a_belt_has_its_frequency():
    belt = on_a_belt(friction=0.0, speed=0.03)
    beside = belt.assign(angle=belt.angle + 0.5)
    assert first_frequency([beside]) == pytest.approx(first_frequency([belt]), rel=0.02)
    with pytest.raises(DecayError, match="0 whole half periods"):
        first_frequency([beside[["angle"]]])
