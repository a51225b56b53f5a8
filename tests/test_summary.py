"""One table of numbers for any result: by method and quantity, without basis functions of curves."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers import FIVE, paper_run

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging, Direct
from sysid_trib.smooth_laws.model import USUAL

RUN = paper_run(FIVE, duration=15.0, sampling_rate=50.0)
LIBRARY = RUN.model.library
FREQUENCIES = ["reference_frequency", "asymptotic_frequency"]


@pytest.fixture(scope="module")
def single():
    return Direct().identify(RUN.decay(1), LIBRARY)


def test_rows_are_coefficients_with_intervals_and_units(single):
    table = st.summary(single)
    assert table.index.names == ["model", "quantity"]
    assert list(table) == ["value", "standard_error", "low", "high", "unit"]
    assert table.loc["direct"].index.tolist() == [*single.force.values, *FREQUENCIES]
    zeta = table.loc[("direct", "zeta")]
    error = single.standard_error.sel(force="zeta").item()
    assert zeta.high - zeta.value == pytest.approx(1.959964 * error)
    assert zeta.value - zeta.low == pytest.approx(1.959964 * error)
    assert table.unit[("direct", "reference_frequency")] == "rad/s"


def test_fixed_parameters_have_no_error(single):
    held = Direct(constraints={"epsilon": 0.3}).identify(RUN.decay(1), LIBRARY)
    row = st.summary(held).loc[("direct", "epsilon")]
    assert (row.value, row.low, row.high, row.standard_error) == (0.3, 0.3, 0.3, 0.0)


def test_both_methods_of_a_cross_check_and_both_samples_of_a_difference(single):
    averaging = Averaging().identify(RUN.decay(1), LIBRARY)
    checked = st.summary(st.cross_check(RUN.decay(1), averaging, single))
    assert checked.index.unique("model").tolist() == ["averaging", "direct"]
    found = st.difference(single, Direct().identify(RUN.decay(2), LIBRARY))
    table = st.summary(found)
    assert table.index.names == ["sample", "quantity"]
    zeta = table.xs("zeta", level="quantity").value
    assert zeta["difference"] == pytest.approx(zeta["first"] - zeta["second"], rel=1e-3)
    assert ("difference", "stiffness_difference") in table.index
    assert table.unit["first", "zeta"] == "1"


def test_units_are_those_of_the_record():
    decay = RUN.decay(1)
    result = Direct().identify(
        decay.assign(angle=("time", 900 * decay.angle.values, {"units": "mm"})), LIBRARY
    )
    assert st.summary(result).unit["direct", "lambda"] == "mm"
    assert st.summary(st.difference(result, result)).unit["difference", "lambda"] == "mm"


@pytest.mark.slow
def test_parts_of_curves_are_left_out(tmp_path: Path):
    tree = st.laws(RUN.decay(1))
    table = st.summary(tree)
    for name in ("averaging", "direct"):
        assert set(table.loc[name].index) == {*USUAL, *FREQUENCIES}
    st.save(tree, tmp_path / "laws.nc")
    assert np.array_equal(st.summary(st.load(tmp_path / "laws.nc")).value, table.value)


@pytest.mark.slow
def test_models_of_a_discovery_and_methods_of_a_comparison():
    decay, start = RUN.decay(1), LIBRARY.select(["lambda", "zeta", "nu", "epsilon"])
    table = st.summary(st.discover(decay, start, LIBRARY.select(["delta"])))
    assert table.index.names == ["model", "quantity"]
    assert ("final model", "delta") in table.index
    assert ("start model", "delta") not in table.index
    compared = st.summary(st.compare(decay, LIBRARY))
    assert {"direct", "averaging"} <= set(compared.index.unique("model"))


@pytest.mark.parametrize(
    "wrong", [xr.Dataset(), xr.DataTree(), RUN.decay(1)], ids=["empty", "tree", "record"]
)
def test_what_is_no_result_is_refused(wrong):
    with pytest.raises(UsageError, match="summary needs a result"):
        st.summary(wrong)
