"""Terms of the sensor together with forces: the measured signal is x + coefficient * h(x, v, t)."""

import json
from dataclasses import replace

import command_line
import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import DecayError
from sysid_trib.methods import Averaging, Direct, FrequencyShift, LogarithmicDecrement, Trajectory
from sysid_trib.validation import driven

SIX = st.load_library("contact_forces")
LIBRARY = replace(SIX, forces=(*SIX.forces, *st.load_library("candidate_effects").forces))
W, NOISE = 4.0, 5e-4
TIME = np.arange(1200) * 0.04
# A camera askew behind a lens, that reads its lines in turn.
TRUTH = {"zeta": 2e-3, "delta": 0.02, "epsilon": -0.16}
TERMS = {"sensor_curve": 0.04, "sensor_cubic": -0.05, "shutter": 0.02}


def record(seed=None, *, density=0.0, truth=TRUTH | TERMS):
    model = st.Model(LIBRARY, truth, W)
    angle = st.simulate(model, TIME, 0.6, random_force=density, seed=seed or 0).angle.values
    if seed is not None:
        angle = angle + NOISE * np.random.default_rng([seed, 3]).standard_normal(len(TIME))
    return xr.Dataset({"angle": ("time", angle)}, {"time": TIME})


def errors(result, truth=TRUTH | TERMS):
    result = result.sel(force=list(truth))
    return (result.coefficient.values - list(truth.values())) / result.standard_error.values


@pytest.mark.parametrize("method", [Direct(), Trajectory()], ids=lambda m: m.scope.label)
def test_a_record_without_noise_has_the_coefficients(method):
    result = method.identify(record(), LIBRARY.select(TRUTH | TERMS))
    truth = np.array(list((TRUTH | TERMS).values()))
    assert result.coefficient.values == pytest.approx(truth, rel=1e-4)


def test_a_curve_that_is_left_out_is_taken_for_a_force():
    result = Direct().identify(record(0), LIBRARY.select([*TRUTH, "even_drag"]))
    assert abs(errors(result, {"even_drag": 0.0})) > 10.0
    beside = Direct().identify(record(0), LIBRARY.select([*TRUTH, *TERMS, "even_drag"]))
    assert abs(errors(beside, {"even_drag": 0.0})) < 4.0


def test_sensor_terms_can_be_fixed_tied_and_dropped():
    decay, library = record(2), LIBRARY.select(TRUTH | TERMS)
    held = Direct(constraints=TERMS).identify(decay, library)
    assert held.coefficient.sel(force=list(TERMS)).values.tolist() == list(TERMS.values())
    assert np.all(np.abs(errors(held, TRUTH)) < 4.0)
    chosen = Direct(significance=0.01).identify(decay, LIBRARY.select([*TRUTH, *TERMS, "sensor_drift"]))
    assert not chosen.active.sel(force="sensor_drift")
    assert chosen.active.sel(force="sensor_curve")


@pytest.mark.parametrize("method", [Averaging(), FrequencyShift(), LogarithmicDecrement()])
def test_methods_of_amplitudes_and_frequencies_refuse_them(method):
    with pytest.raises(DecayError, match="'sensor_curve' is a sensor term"):
        method.identify(record(0), LIBRARY.select(["zeta", "epsilon", "sensor_curve"]))


def test_a_sensor_term_alone_is_no_model():
    with pytest.raises(DecayError, match="There is no force to identify"):
        Direct().identify(record(0), LIBRARY.select(["sensor_curve"]))


def test_the_command_line_takes_forces_and_terms_of_the_libraries_that_come_along(tmp_path):
    truth = {k: (TRUTH | TERMS)[k] for k in ("zeta", "epsilon", "sensor_curve")}
    file = command_line.write_csv(tmp_path / "record.csv", TIME, record(3, truth=truth).angle.values)
    asked = ("identify", file, "--forces", ",".join(truth), "--random-force", "off", "--equilibrium", "0")
    said = command_line.run(*asked, "--json")
    assert said.status == 0, said.err
    methods = json.loads(said.out)["methods"]
    assert set(methods) == {"trajectory", "direct"}
    for method in methods.values():
        term = method["coefficients"]["sensor_curve"]
        assert abs(term["value"] - truth["sensor_curve"]) < 4.0 * term["standard_error"]


# Another run with different sensor terms.

OTHER_TERMS = {"sensor_curve": -0.03, "sensor_cubic": 0.02, "shutter": -0.01}


def without_refit(monkeypatch, result, other):
    """The prediction with the sensor terms of the other record's run imposed."""
    with monkeypatch.context() as patch:
        patch.setattr(driven, "with_own_sensor", lambda result, model, record, fitted: (model, record))
        return st.predict(result, other)


@pytest.mark.parametrize("warm_up", [None, 20.0])
def test_a_prediction_fits_the_sensor_to_its_record(monkeypatch, warm_up):
    result = Direct().identify(record(0), LIBRARY.select(TRUTH | TERMS))
    other = record(5, truth=TRUTH | OTHER_TERMS)
    found = st.predict(result, other, warm_up=warm_up)
    assert found.attrs["refitted_sensors"] == "sensor_curve, sensor_cubic, shutter"
    assert found.residual_rms < 1.5 * NOISE
    assert without_refit(monkeypatch, result, other).residual_rms > 5.0 * NOISE


def test_sensor_terms_stay_where_they_are_held_or_of_the_own_record():
    own, other = record(0), record(5, truth=TRUTH | OTHER_TERMS)
    held = Direct(constraints=TERMS).identify(own, LIBRARY.select(TRUTH | TERMS))
    assert "refitted_sensors" not in st.predict(held, other).attrs
    known = own.assign_attrs(record_checksum="a1")
    result = Direct().identify(known, LIBRARY.select(TRUTH | TERMS))
    assert "refitted_sensors" not in st.predict(result, known).attrs
    plain = Direct().identify(own, LIBRARY.select(TRUTH))
    assert "refitted_sensors" not in st.predict(plain, other).attrs


def test_each_runs_own_sensor_terms_are_fitted_too():
    runs = [record(0), record(1, truth=TRUTH | OTHER_TERMS)]
    result = Direct(own=tuple(TERMS)).identify(runs, LIBRARY.select(TRUTH | TERMS))
    third = {"sensor_curve": 0.0, "sensor_cubic": 0.03, "shutter": 0.015}
    found = st.predict(result, record(7, truth=TRUTH | third))
    assert found.attrs["refitted_sensors"].startswith("sensor_curve_1")
    assert found.residual_rms < 1.5 * NOISE


@pytest.mark.slow
def test_another_film_has_a_camera_of_its_own(monkeypatch, data_folder):
    """The string pendulum on two films: forces of one predict the other, its sensor fitted to it."""
    folder = data_folder / "string_pendulum"
    low, high = (
        st.free_decay(st.read_record(folder / name, angle=1, units="rad"))
        for name in ("run_1.txt", "run_high.txt")
    )
    # Before, the bob is still held.
    high = high.sel(time=slice(0.3, None))
    forces = ["gravity", "zeta", "delta", "epsilon"]
    results = [
        Direct(constraints={"gravity": 1.0}).identify(low, LIBRARY.select(names))
        for names in (forces, [*forces, "shutter", "sensor_curve"])
    ]
    without, fitted = (st.predict(result, high).residual_rms.item() for result in results)
    imposed = without_refit(monkeypatch, results[1], high).residual_rms.item()
    assert fitted < 0.8 * imposed
    assert fitted < without
