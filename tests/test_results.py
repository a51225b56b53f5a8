"""The one schema of an identification: labels, provenance, files."""

import json

import numpy as np
import pytest
import xarray as xr
from candidates import CANDIDATES
from helpers import FIVE, SIX, Run, W, library_of_formulas, paper_run

import sysid_trib
from sysid_trib import Model, load_library
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Averaging, Direct
from sysid_trib.results.files import load, save
from sysid_trib.results.references import with_contactless_frequency
from sysid_trib.results.schema import (
    asymptotic_frequency,
    covariance_with_frequency,
    library_of,
    map_identifications,
    model_of,
)
from sysid_trib.simulation.simulate import trajectory

FORCES = load_library()
PER_FORCE = {"coefficient", "standard_error", "covariance", "active", "refers_to"}
SCALARS = {"reference_frequency", "asymptotic_frequency", "noise", "birge_ratio"}


def record(**attrs):
    return paper_run().decay(0).assign_attrs(attrs)


@pytest.mark.parametrize("method", [Averaging(correct=False), Direct(), Direct(form="strong")], ids=str)
def test_every_method_returns_the_same_schema(method):
    result = method.identify(record(), FORCES)
    assert set(result.data_vars) >= PER_FORCE | SCALARS
    assert result.covariance.dims == ("force", "other_force")
    assert all(result[name].dims == () for name in SCALARS)
    assert all(v.attrs.get("long_name") for v in result.data_vars.values())
    assert all("units" in result[name].attrs for name in SCALARS)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), result.standard_error, rtol=1e-9)
    assert result.unit.values.tolist() == ["1"] * 5
    assert result.formula.sel(force="zeta").item() == "2*v"
    assert np.all(result.refers_to == result.reference_frequency)


def test_provenance():
    attrs = Direct(W, shapes={}).identify(record(source="run.csv", record_checksum="abc"), FORCES).attrs
    assert attrs["method"] == "direct"
    assert json.loads(attrs["options"])["reference_frequency"] == W
    assert attrs["sysid_trib_version"] == sysid_trib.__version__
    assert (attrs["record_source"], attrs["record_checksum"]) == (["run.csv"], ["abc"])
    assert attrs["library_title"] == FORCES.title
    # netCDF holds nothing else in attributes.
    assert all(isinstance(value, str | int | float | list) for value in attrs.values())


def test_library_and_model_come_back():
    result = Direct(W, significance=0.01).identify(record(), FORCES)
    assert library_of(result).symbols == tuple(SIX)
    assert library_of(result, whole=True).forces == FORCES.forces
    model = model_of(result)
    assert set(model.coefficients) == set(FIVE)
    assert model.reference_frequency == W
    assert model.coefficients["nu"] == result.coefficient.sel(force="nu").item()


def test_a_model_read_back_moves_as_the_record():
    result = Direct(W).identify(record(), FORCES)
    time = record().time.values
    angle = trajectory(model_of(result), time, result.start_angle.item(), result.start_rate.item()).angle
    gap = record().angle.values - result.offset.item() - angle
    assert np.sqrt(np.mean(gap**2)) == pytest.approx(1e-4, rel=0.05)


def test_shape_parameters_are_kept():
    entries = [{"symbol": "zeta", "formula": "2*v"}, {"symbol": "stribeck", **CANDIDATES["stribeck"]}]
    library = parse_library({"force": entries}, "test")
    shapes = {"stribeck.s": 0.04}
    run = Run(Model(library, {"zeta": 0.01, "stribeck": 5e-4}, W, shapes), paper_run(duration=14.0).time)
    result = Direct(W, shapes=shapes).identify(run.decay(0), library)
    assert result.shape.sel(shape_parameter="stribeck.s").item() == 0.04
    assert np.isnan(result.shape_standard_error).all()
    assert model_of(result).shapes == shapes
    assert np.all(np.abs(result.coefficient - [0.01, 5e-4]) < 4.0 * result.standard_error)


def test_saved_and_read_back_the_same(tmp_path):
    result = Averaging(correct=False).identify(record(), FORCES)
    save(result, tmp_path / "one.nc")
    xr.testing.assert_identical(load(tmp_path / "one.nc").to_dataset(), result)
    tree = xr.DataTree.from_dict({"averaging": result, "direct": Direct(W).identify(record(), FORCES)})
    save(tree, tmp_path / "two.nc")
    back = load(tmp_path / "two.nc")
    xr.testing.assert_identical(back, tree)
    assert back["direct"].active.dtype == bool
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.nc", "two.nc"]


def test_unreadable_result_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no file"):
        load(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("time,angle\n")
    with pytest.raises(RecordError, match=r"text\.nc: not a result"):
        load(tmp_path / "text.nc")


def test_asymptotic_frequency_and_its_gradient():
    coefficients = np.array([1e-3, 0.05, 0.037, 0.25, -0.4, 0.3])
    found, gradient = asymptotic_frequency(FORCES, coefficients, W)
    # Le Bot et al. 2019, with alpha and zeta together: not the product sqrt(1 + alpha) sqrt(1 - zeta^2).
    assert found / W == pytest.approx(1.116915, abs=5e-7)
    step = 1e-6
    for j in range(7):
        moved = np.append(coefficients, W)
        moved[j] += step
        there, _ = asymptotic_frequency(FORCES, moved[:-1], moved[-1])
        assert gradient[j] == pytest.approx((there - found) / step, rel=1e-4, abs=1e-6)


def test_a_viscous_force_without_its_factor_two_counts_alike():
    plain = asymptotic_frequency(library_of_formulas(c="v"), np.array([0.1]), W)[0]
    assert plain == pytest.approx(asymptotic_frequency(library_of_formulas(c="2*v"), np.array([0.05]), W)[0])


def test_only_identifications_of_a_tree_are_changed():
    result = Averaging(correct=False).identify(record(), FORCES)
    tree = xr.DataTree.from_dict({"record": record(), "averaging": result})
    changed = map_identifications(tree, lambda found: found.assign_attrs(seen="yes"))
    assert changed["averaging"].attrs["seen"] == "yes"
    assert "seen" not in changed["record"].attrs


def test_a_frequency_without_contact_changes_no_covariance_with_the_reference_frequency():
    result = Direct(random_force="off").identify(record(), FORCES)
    with_alpha = with_contactless_frequency(result, 8.87, 0.02)
    kept = [*(with_alpha.force.values.tolist().index(symbol) for symbol in result.force.values), -1]
    there = covariance_with_frequency(with_alpha)[np.ix_(kept, kept)]
    np.testing.assert_allclose(there, covariance_with_frequency(result), rtol=1e-9)
