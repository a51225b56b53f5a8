"""Comparison of two samples: coefficients that differ, errors between runs, and texts."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run as command
from helpers import FIVE, paper_run

from sysid_trib import difference, identify, load, plots
from sysid_trib.errors import UsageError
from sysid_trib.methods import Direct
from sysid_trib.printing.campaign import difference_blocks
from sysid_trib.questions.difference import held_against
from sysid_trib.validation import sensitivity

RUN = paper_run(FIVE, duration=15.0)
LIBRARY = RUN.model.library
MORE_FRICTION = replace(RUN, model=RUN.model.with_coefficients(FIVE | {"zeta": 0.0101}))


def identified(run, *seeds):
    return [identify(run.decay(seed), LIBRARY, Direct()) for seed in seeds]


@pytest.fixture(scope="module")
def samples():
    """Two runs of one material, and one of another with more viscous friction."""
    return identified(RUN, 1, 2), identified(MORE_FRICTION, 3)


def test_the_mean_of_equal_runs_is_known_better_than_each(samples):
    both, (other,) = samples
    single, pooled = difference(both[0], other), difference(both, other)
    of_zeta = [found.first_standard_error.sel(force="zeta").item() for found in (pooled, single)]
    assert of_zeta[0] == pytest.approx(of_zeta[1] / np.sqrt(2.0), rel=0.02)
    assert np.isnan(single.first_between_runs.values).all()
    assert pooled.attrs["verdict"] != "no difference"
    assert pooled.attrs["first_record"] == [r.attrs["record_source"][0] for r in both]
    # Exchanged, the differences change their sign, to the change of reference.
    turned = difference([other], both)
    assert turned.z.values == pytest.approx(-pooled.z.values, abs=0.02)


def test_runs_that_scatter_widen_the_error_of_their_mean():
    runs = [
        replace(RUN, model=RUN.model.with_coefficients(FIVE | {"zeta": z})) for z in (0.0095, 0.0097, 0.0099)
    ]
    results = [one for at, run in enumerate(runs) for one in identified(run, at)]
    found = difference(results, results[:1])
    zeta = found.sel(force="zeta")
    assert zeta.first_between_runs.item() == pytest.approx(2e-4, rel=0.5)
    assert zeta.first_standard_error.item() == pytest.approx(2e-4 / np.sqrt(3.0), rel=0.5)
    assert not zeta.differs.item()


def test_friction_alone_is_no_stiffness():
    runs = [replace(RUN, model=RUN.model.with_coefficients(FIVE | {"zeta": z})) for z in (0.005, 0.05)]
    found = difference(*(identify(run.decay(1), LIBRARY, Direct()) for run in runs))
    assert abs(found.stiffness_difference) < 3.0 * found.stiffness_difference_standard_error
    # That of the frequencies is 0.05^2 - 0.005^2.
    assert found.stiffness_difference_standard_error < 2e-4
    # Also if the first sample lacks this force.
    free = replace(RUN, model=RUN.model.with_coefficients(FIVE | {"zeta": 0.0}))
    without = identify(free.decay(1), LIBRARY.select([s for s in FIVE if s != "zeta"]), Direct())
    found = difference(without, identify(runs[1].decay(1), LIBRARY, Direct()))
    assert abs(found.stiffness_difference) < 3.0 * found.stiffness_difference_standard_error


def test_coefficients_fixed_in_both_do_not_differ_at_another_frequency():
    holding = Direct(constraints={"epsilon": FIVE["epsilon"]})
    runs = [replace(RUN, model=replace(RUN.model, reference_frequency=w)) for w in (9.9, 9.8)]
    found = difference(*(identify(run.decay(1), LIBRARY, holding) for run in runs))
    epsilon = found.sel(force="epsilon")
    assert (epsilon.difference.item(), epsilon.standard_error.item()) == (0.0, 0.0)
    assert np.isnan(epsilon.z.item())
    assert not epsilon.differs.item()
    assert found.degrees_of_freedom.item() == found.sizes["force"] - 1
    assert abs(found.stiffness_difference / found.stiffness_difference_standard_error) > 10.0


def test_results_of_identify_and_other_objects(samples):
    (first, _), (other,) = samples
    for wrong in ([], [first, RUN.decay(1)], "a.csv", None):
        with pytest.raises(UsageError, match="two identifications"):
            difference(first, wrong)
    assert difference(first, other).attrs["first_method"] == "direct"


def test_samples_that_differ_in_no_single_coefficient_are_described_in_two_sentences():
    tree = held_against([RUN.decay(1)], [MORE_FRICTION.decay(2)], LIBRARY, Direct())
    tree.attrs["verdict"] = "together they differ"
    tree["differs"] = tree.differs & False
    first = " ".join(s for block in difference_blocks(tree)[:2] for s in block.sentences)
    assert "for 5 degrees of freedom" in first
    assert "the records do not determine in which coefficients. These differences explain it" in first


def test_equal_samples_do_not_differ():
    first, second = identified(RUN, 100, 200)
    assert difference(first, second, level=1e-5).attrs["verdict"] == "no difference"


@pytest.mark.in_full
def test_equal_samples_differ_at_the_rate_of_the_level():
    first, second = (identified(RUN, *range(at, at + 12)) for at in (100, 200))
    p_values = [difference(a, b).p_value_of_all.item() for a, b in zip(first, second, strict=True)]
    # Of twelve uniform ones: 1 in 10,000 sets of them has one below.
    assert min(p_values) > 1e-5
    assert np.mean(np.array(p_values) < 0.5) < 0.95


def test_a_coefficient_at_its_bound_is_pointed_out():
    below = {"zeta": (None, 0.5 * FIVE["zeta"])}
    runs = [RUN.decay(1)], [RUN.decay(2)]
    tree = held_against(*runs, LIBRARY, Direct(), constraints=below)
    text = "\n".join(sentence for block in difference_blocks(tree) for sentence in block.sentences)
    assert "Not tested, because it is at a bound: zeta in " in text


def test_no_test_rests_on_a_coefficient_at_its_bound():
    below = {"zeta": (None, 0.5 * FIVE["zeta"])}
    bounded, free = (identify(RUN.decay(1), LIBRARY, Direct(), constraints=c) for c in (below, {}))
    found = difference(bounded, free)
    zeta = found.sel(force="zeta")
    assert abs(zeta.z.item()) > 2.0
    assert not zeta.differs.item()
    assert found.attrs["at_a_bound"] == "zeta"
    assert found.degrees_of_freedom.item() == found.sizes["force"] - 1


@pytest.mark.slow
def test_the_command_prints_the_differences_first_and_writes_all_numbers(tmp_path):
    for name, run, seed in (("a.csv", RUN, 1), ("b.csv", MORE_FRICTION, 2), ("c.csv", MORE_FRICTION, 3)):
        run.decay(seed).to_dataframe().to_csv(tmp_path / name)
    a, b, c = (str(tmp_path / name) for name in ("a.csv", "b.csv", "c.csv"))
    out, table, tex, page = (str(tmp_path / name) for name in ("d.nc", "d.csv", "d.tex", "d.html"))
    ending = command("difference", a, b, "--csv", table, "--latex", tex, "-o", out, "--plot", str(tmp_path))
    assert ending.status == 0, ending.err
    first = ending.out.splitlines()[0]
    assert "if the others are zero: zeta by (-4." in first or first.startswith("zeta differs:")
    assert (tmp_path / "difference.pdf").exists()
    assert "first minus second,zeta" in (tmp_path / "d.csv").read_text()
    assert "difference" in (tmp_path / "d.tex").read_text()
    kept = load(out)
    assert plots.difference(kept).axes[2].get_xlabel() == "first minus second, over its standard error"
    assert command("report", out, "-o", page).status == 0
    assert "st.difference(results[:1], results[1:])" in (tmp_path / "d.html").read_text()
    text = "\n".join(sentence for block in difference_blocks(kept) for sentence in block.sentences)
    assert "Stiffness of a.csv over that of b.csv, minus 1: " in text
    assert "Standard errors of b.csv, by the noise and by the model: " in text
    several = command("difference", a, ":", b, c, "--json")
    data = json.loads(several.out)
    assert data["verdict"] != "no difference"
    assert data["coefficients"]["zeta"]["second_between_runs"] is not None


def in_mm(seed):
    """The record as a displacement: 900 mm a radian."""
    decay = RUN.decay(seed)
    return decay.assign(angle=("time", 900.0 * decay.angle.values, {"units": "mm"}))


def test_a_displacement_has_the_coefficients_of_its_unit(samples):
    first, second = (identify(in_mm(seed), LIBRARY, Direct()) for seed in (1, 2))
    found, of_angles = difference(first, second), difference(*samples[0])
    assert found["first"].values == pytest.approx(first.coefficient.values, rel=1e-9)
    assert found.standard_error.sel(force="lambda").item() == pytest.approx(
        900.0 * of_angles.standard_error.sel(force="lambda").item(), rel=1e-3
    )
    fits = sensitivity([in_mm(1)], first)
    assert fits.estimate.values == pytest.approx(first.coefficient.values, rel=1e-9)
    assert fits.coefficient.sel(force="delta").median().item() == pytest.approx(
        first.coefficient.sel(force="delta").item(), rel=0.2
    )
