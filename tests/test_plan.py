"""The next run: what it would tell of competing models, and of the errors of one."""

import json

import numpy as np
import pytest
from command_line import run as command
from helpers import FIVE, NOISE, paper_run
from scipy.stats import norm

from sysid_trib import identify, save
from sysid_trib.errors import UsageError
from sysid_trib.validation import plan
from sysid_trib.validation.next_run import ODDS, Rival, _informed, _parting

RUN = paper_run(FIVE, duration=15.0)
SAME = {"amplitude": (0.3, 0.3), "duration": (15.0, 15.0), "sampling_rate": 100.0}


@pytest.fixture(scope="module")
def tree():
    return identify(RUN.decay(1), RUN.model.library)


def test_the_same_run_once_more_takes_the_root_of_two_from_the_errors(tree):
    result = tree["direct"].to_dataset()
    (once,), (thrice,) = (plan(result, **SAME, repeats=count).standard_error.values for count in (1, 3))
    assert once / result.standard_error.values == pytest.approx(np.full(5, 0.5**0.5), rel=0.05)
    assert thrice / result.standard_error.values == pytest.approx(np.full(5, 0.5), rel=0.05)


def test_what_is_wanted_is_had_by_the_shortest_run_that_has_it(tree):
    stated = tree["direct"].standard_error.sel(force="delta").item()
    found = plan(tree, wanted={"delta": 0.5 * stated})
    met = found.meets.values
    assert met[0]
    assert not met.all()
    assert found.duration.values[0] == found.duration.values[met].min()
    nothing = plan(tree, wanted={"delta": 1e-3 * stated})
    assert not nothing.meets.any()


def test_motions_that_a_rival_can_make_tell_nothing(tree):
    result = tree["direct"].to_dataset()
    rival = Rival("it", RUN.model, plan_covariance(result), 1.0)
    time = np.arange(0.0, 15.0, 0.01)
    truth, other = rival.motion(time, 0.3), rival.motion(time, 0.3)
    assert _parting(truth, other, rival, NOISE)[-1] == pytest.approx(0.0, abs=1e-9)
    # Another release is the rival's own start, and another zero.
    moved = truth[0] + 1e-4 * truth[1][:, -3] + 1e-4, truth[1]
    assert _parting(moved, other, rival, NOISE)[-1] < 1e-3
    # A force that it has not is told apart.
    ripple = truth[0] + 1e-3 * np.cos(35.0 * time), truth[1]
    assert _parting(ripple, other, rival, NOISE)[-1] > 1e4


def plan_covariance(result):
    count = result.sizes["force"]
    covariance = np.zeros((count + 1, count + 1))
    covariance[:count, :count] = result.covariance.values
    covariance[-1, -1] = result.asymptotic_frequency_standard_error.item() ** 2
    return covariance


@pytest.mark.parametrize("distance", [0.0, 5.0, 30.0])
def test_two_models_are_told_apart_as_often_as_their_distance_says(distance):
    entropy, probability = _informed(np.array([0.5, 0.5]), np.array([[0.0, distance], [distance, 0.0]]))
    root = max(np.sqrt(distance), 1e-9)
    assert probability == pytest.approx(norm.cdf((0.5 * distance - np.log(ODDS)) / root), abs=0.06)
    assert 0.0 <= entropy <= np.log(2.0) + 1e-12
    if not distance:
        assert entropy == pytest.approx(np.log(2.0))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"amplitude": (0.5, 0.1)}, "lower one first"),
        ({"duration": (0.0, 5.0)}, "above zero"),
        ({"wanted": {"gravity": 1.0}}, "no coefficient 'gravity'"),
    ],
)
def test_what_cannot_be_planned_is_refused(tree, options, words):
    with pytest.raises(UsageError, match=words):
        plan(tree, **options)


@pytest.mark.slow
def test_the_command_plans_from_a_result(tmp_path, tree):
    save(tree, tmp_path / "r.nc")
    ending = command("plan", str(tmp_path / "r.nc"), "--amplitude", "0.1:0.5", "--plot", str(tmp_path))
    assert ending.status == 0, ending.err
    assert ending.out.startswith("Release at 0.5 rad and record 30 s: lambda ±")
    assert (tmp_path / "plan.pdf").exists()
    data = json.loads(command("plan", str(tmp_path / "r.nc"), "--want", "zeta=1", "--json").out)
    assert data["runs"][0]["meets"] is True
    assert command("plan", str(tmp_path / "r.nc"), "--amplitude", "5").status == 2


@pytest.mark.slow
def test_rivals_of_a_discovery_part_at_a_larger_release():
    """Gravity and a cubic stiffness are alike at small amplitudes; synthetic."""
    from sysid_trib import Model, discover, free_decay, load_library, simulate

    model = Model(load_library().select(["zeta", "epsilon"]), {"zeta": 0.01, "epsilon": -0.167}, 9.9)
    time = np.arange(0.0, 12.0, 0.02)
    angle = simulate(model, time, 0.25).angle.values + 2e-3 * np.random.default_rng(0).standard_normal(
        len(time)
    )
    found = discover(free_decay(np.column_stack([time, angle])))
    runs = plan(found, amplitude=(0.1, 0.8))
    assert {"epsilon", "gravity"} <= set(runs.attrs["models"])
    best, smallest = runs.isel(run=0), runs.isel(run=np.argmin(runs.amplitude.values))
    assert best.amplitude.item() > 0.4
    assert best.entropy.item() < smallest.entropy.item()
