"""The next run: its information on competing models, and on the errors of one model."""

import json

import numpy as np
import pytest
import xarray as xr
from command_line import run as command, write_csv
from helpers import FIVE, measured, paper_run
from scipy.stats import norm

from benchmarks.plan import step
from sysid_trib import Model, free_decay, identify, plots, save, simulate
from sysid_trib.errors import UsageError
from sysid_trib.methods import Direct
from sysid_trib.questions.rivals import ODDS, Rival, informed, log_odds, parting_of
from sysid_trib.validation import plan

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


def test_a_random_force_pushes_the_next_run_too():
    model = Model(RUN.model.library.select(["zeta", "delta"]), {"zeta": 0.01, "delta": 0.03}, 9.9)
    time = np.arange(0.0, 12.0, 0.02)
    record = measured(model, time, noise=1e-3, seed=1, random_force=1e-3)
    pushed = identify(free_decay(record), model.library)["direct"].to_dataset()
    same = {"amplitude": (0.3, 0.3), "duration": (12.0, 12.0), "sampling_rate": 50.0}
    errors = plan(pushed, **same).standard_error.values[0]
    assert errors / pushed.standard_error.values == pytest.approx(np.full(2, 0.5**0.5), rel=0.05)


def test_a_wanted_error_is_reached_by_the_shortest_sufficient_run(tree):
    stated = tree["direct"].standard_error.sel(force="delta").item()
    found = plan(tree, wanted={"delta": 0.5 * stated})
    met = found.meets.values
    assert met[0]
    assert not met.all()
    assert found.duration.values[0] == found.duration.values[met].min()
    nothing = plan(tree, wanted={"delta": 1e-3 * stated})
    assert not nothing.meets.any()
    (panel,) = plots.plan(nothing).axes
    assert min(line.get_ydata()[0] for line in panel.lines) == 1e-3 * stated
    assert [text.get_text() for text in panel.texts] == [f"wanted: {1e-3 * stated:g}"]


def test_a_displacement_in_micrometres_plans_as_its_angle():
    record = RUN.decay(1)
    displacement = record.assign(angle=("time", 1e4 * record.angle.values, {"units": "µm"}))
    known, same = (identify(run, RUN.model.library, Direct()) for run in (displacement, record))
    found, expected = (
        plan(result, amplitude=limits, duration=(8.0, 16.0), sampling_rate=100.0)
        for result, limits in ((known, (500.0, 4000.0)), (same, (0.05, 0.4)))
    )
    assert found.amplitude.values == pytest.approx(1e4 * expected.amplitude.values, rel=1e-6)
    # (1e4 micrometres)^(1 - p) for each force of degree p.
    factors = 1e4 ** np.array([1.0, 0.0, -1.0, -1.0, -2.0])
    assert found.standard_error.values == pytest.approx(factors * expected.standard_error.values, rel=0.01)


def test_no_run_is_longer_than_its_motion():
    model = Model(RUN.model.library.select(["lambda", "zeta"]), {"lambda": 1e-3, "zeta": 0.005}, 9.9)
    time = np.arange(0.0, 20.0, 0.02)
    stop = simulate(model, time, 0.2).stop_time.item()
    result = identify(free_decay(measured(model, time, 0.2, noise=2e-4)), model.library, Direct())
    found = plan(result, amplitude=(0.1, 0.2), duration=(5.0, 60.0), sampling_rate=50.0)
    longest = found.duration.where(found.amplitude > 0.19).max()
    assert longest == pytest.approx(stop, abs=0.4)
    assert longest > found.duration.where(found.amplitude < 0.11).max()


TIME = np.arange(0.0, 15.0, 0.01)


def rival(name, probability, parameters=0):
    return Rival(name, RUN.model, np.zeros((6, parameters)), probability)


def prediction(angle):
    """A motion over the noise that nothing but its start and zero moves."""
    return np.column_stack([angle, np.cos(9.9 * TIME), np.sin(9.9 * TIME), np.ones(len(TIME))])


def told(distance, *probabilities):
    """Entropy and probability for two motions at this distance, which no change of the start can produce."""
    ripple = np.cos(35.0 * TIME)
    ripple *= distance**0.5 / np.linalg.norm(ripple)
    names = zip("ab", probabilities, (0.0, 1.0), strict=True)
    logs = log_odds([(rival(name, p), prediction(of * ripple)) for name, p, of in names])
    return informed(np.array(probabilities), logs)


@pytest.mark.parametrize("distance", [0.0, 5.0, 30.0])
def test_two_models_are_separated_as_often_as_their_distance_predicts(distance):
    entropy, probability = told(distance, 0.5, 0.5)
    root = max(np.sqrt(distance), 1e-9)
    assert probability == pytest.approx(norm.cdf((0.5 * distance - np.log(ODDS)) / root), abs=0.06)
    assert 0.0 <= entropy <= np.log(2.0) + 1e-12
    if not distance:
        assert entropy == pytest.approx(np.log(2.0))


def test_more_repeats_never_give_less_information():
    """The square of the distance is proportional to the number of repeats."""
    left, right = np.array([told(3.0 * repeats, 0.7, 0.3) for repeats in (1, 2, 3, 5, 9)]).T
    assert np.all(np.diff(left) < 0.0)
    assert np.all(np.diff(right) > 0.0)


def test_motions_that_a_rival_can_produce_give_no_information():
    still = prediction(np.zeros(len(TIME)))
    own = prediction(3.0 * np.cos(9.9 * TIME) + 2.0)
    # A difference that its own parameters can produce does not count, however large it is.
    ripple = np.cos(35.0 * TIME)
    moved = np.column_stack([50.0 * ripple, 1e4 * ripple, still[:, 1:]])
    for other, parameters in ((own, 0), (moved, 1)):
        logs = log_odds([(rival("a", 0.5), still), (rival("b", 0.5, parameters), other)])
        # A parameter makes half of the square of a normal number of noise too.
        assert np.mean(logs[0][:, 1] - logs[0][:, 0]) == pytest.approx(0.5 * parameters, abs=0.1)
    # A force that the model lacks can be distinguished.
    assert parting_of(prediction(ripple), still)[-1] > 700.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"amplitude": (0.5, 0.1)}, "lower one first"),
        ({"duration": (0.0, 5.0)}, "above zero"),
        ({"wanted": {"gravity": 1.0}}, "no coefficient 'gravity'"),
        ({"wanted": {"zeta": 0.0}}, "must be positive"),
    ],
)
def test_impossible_plans_are_refused(tree, options, words):
    with pytest.raises(UsageError, match=words):
        plan(tree, **options)


def test_a_coefficient_that_is_held_has_no_error_to_be_wanted():
    held = identify(RUN.decay(1), RUN.model.library, constraints={"epsilon": FIVE["epsilon"]})
    assert "epsilon" not in plan(held, **SAME).force
    with pytest.raises(UsageError, match="'epsilon' is fixed"):
        plan(held, wanted={"epsilon": 0.1})


def test_no_run_of_a_driven_body_is_planned(tree):
    record = tree["record"].to_dataset()
    push = xr.DataArray(np.zeros(record.sizes["time"]), dims="time", attrs={"role": "input", "units": "V"})
    driven = xr.DataTree.from_dict({"record": record.assign(voltage=push)})
    with pytest.raises(UsageError, match="is for free decays; the records"):
        plan(driven)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["plan", "export", "response --drive 0.1"])
def test_a_difference_is_no_model(tmp_path, words):
    runs = [measured(RUN.model, np.arange(0.0, 6.0, 0.02), seed=seed) for seed in (1, 2)]
    records = [
        write_csv(tmp_path / f"{at}.csv", run.time.values, run.angle.values) for at, run in enumerate(runs)
    ]
    result = tmp_path / "d.nc"
    assert command("difference", *records, "--forces", "zeta", "-o", result).status == 0
    name, *options = words.split()
    ending = command(name, result, *options)
    assert ending.status == 2
    assert "is a comparison of samples, not a model; give a result of identify" in ending.err


@pytest.mark.slow
def test_the_command_plans_from_a_result(tmp_path, tree):
    save(tree, tmp_path / "r.nc")
    ending = command("plan", str(tmp_path / "r.nc"), "--amplitude", "0.1:0.5", "--plot", str(tmp_path))
    assert ending.status == 0, ending.err
    assert ending.out.startswith(
        "Release at 0.5 rad and record 30 s. Standard errors from all records together: lambda "
    )
    assert (tmp_path / "plan.pdf").exists()
    data = json.loads(command("plan", str(tmp_path / "r.nc"), "--want", "zeta=1", "--json").out)
    assert data["runs"][0]["meets"] is True
    assert command("plan", str(tmp_path / "r.nc"), "--amplitude", "5").status == 2


def test_a_model_error_is_reported_as_permanent(tmp_path, tree):
    result = tree["direct"].to_dataset()
    parts = {"error_of_noise": result.standard_error, "error_of_model": 2e-3 + 0.0 * result.standard_error}
    incomplete = result.assign(parts)
    save(incomplete, tmp_path / "result.nc")
    limits = ("--amplitude", "0.1:0.3", "--duration", "5:15", "--rate", "100")
    ending = command("plan", tmp_path / "result.nc", *limits)
    assert "The model error (lambda 0.002," in ending.out, ending.err


@pytest.mark.slow
def test_rivals_of_a_discovery_part_at_a_larger_release():
    """Gravity and a cubic stiffness are similar at small amplitudes; synthetic."""
    from sysid_trib import discover, load_library

    model = Model(load_library().select(["zeta", "epsilon"]), {"zeta": 0.01, "epsilon": -0.167}, 9.9)
    time = np.arange(0.0, 12.0, 0.02)
    found = discover(free_decay(measured(model, time, 0.25, noise=2e-3)))
    runs = plan(found, amplitude=(0.1, 0.8))
    assert {"epsilon", "gravity"} <= set(runs.attrs["models"])
    best, smallest = runs.isel(run=0), runs.isel(run=np.argmin(runs.amplitude.values))
    assert best.amplitude.item() > 0.4
    assert best.entropy.item() < smallest.entropy.item()
    stands = found["steps"].symbol.item()
    other = ({"epsilon", "gravity"} - {stands}).pop()
    with pytest.raises(UsageError, match=f"'{other}' competes with '{stands}'"):
        plan(found, wanted={other: 0.1})


@pytest.mark.in_full
def test_probabilities_stated_by_a_plan_are_correct():
    """Effects drawn from all candidates, synthetic; of rows that are not the best it is too sure."""
    runs = [run for seed in range(100, 130) for run in step(seed, drawn=True)[1] if run[1] >= 0 and run[3]]
    stated, came = np.array(runs, dtype=float).T[:2]
    error = np.sqrt(np.sum(stated * (1.0 - stated))) / len(runs)
    assert abs(came.mean() - stated.mean()) < 0.05 + 2.0 * error
