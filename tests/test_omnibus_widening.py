"""Errors of a model that lacks a force: widened as far as scores of forces of any form exceed noise's."""

import numpy as np
import pytest
from discovery import BASE, EVERY, start_model, with_effect

from sysid_trib import discover
from sysid_trib.discovery.omnibus_test import OmnibusTest
from sysid_trib.discovery.screen import screen
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.json_results import discovery_json
from sysid_trib.results.discoveries import error_widening

KNOWN = {"lambda": 1e-3, "zeta": 9.7e-3, "delta": 0.037, "epsilon": 0.3}
LEVEL = 0.01
# As strong as some tenth of the friction, or of the cubic force.
MISSING = {
    **dict.fromkeys(("cubic_damping", "angle_damping", "angle_drag", "van_der_pol", "even_drag"), 0.02),
    **dict.fromkeys(("structural_damping", "even_spring", "bilinear", "quintic"), 0.02),
    "friction_drift": 2e-5,
    "damping_drift": 2e-4,
    "stiffness_drift": 1e-4,
}


@pytest.mark.parametrize(
    ("z", "p_value", "factor"),
    [
        ([6.0, 0.0, -8.0], 1e-9, np.sqrt(50.0)),
        ([-7.0], 1e-9, 7.0),
        ([6.0, 0.0, -8.0], 0.02, 1.0),
        ([0.5, -0.2], 1e-9, 1.0),
        ([0.0, 0.0], 1e-9, 1.0),
    ],
)
def test_errors_are_widened_by_the_scores_where_the_test_rejects(z, p_value, factor):
    """What is not tested has the score 0, and counts for nothing."""
    names = tuple(str(at) for at in range(len(z)))
    assert OmnibusTest(names, np.array(z), p_value).widening(LEVEL) == pytest.approx(factor)


@pytest.mark.in_full
def test_widened_errors_cover_more_of_what_a_model_without_a_force_says():
    """By the noise alone some half of 95 % intervals do."""
    library, inside = BASE.select(KNOWN), []
    for seed, (symbol, coefficient) in enumerate(MISSING.items()):
        model = start_model([with_effect({symbol: coefficient}, seed=seed, base=KNOWN)], library)
        factor = screen(model, [EVERY["bias"]]).omnibus.widening(LEVEL)
        errors = np.sqrt(np.diag(model.covariance_with_frequency()))[:-1]
        off = np.abs(model.coefficients - list(KNOWN.values())) / errors
        inside.append([off < 1.96, off < 1.96 * factor])
    plain, widened = np.mean(inside, axis=(0, 2))
    assert plain < 0.7
    assert widened > 0.8


@pytest.mark.slow
def test_all_errors_of_a_discovery_are_widened(monkeypatch):
    """Of coefficients, shapes and the frequency, in the steps and in the identification."""
    run = with_effect({"even_spring": 0.02, "dahl": 0.01}, seed=1, base=KNOWN, shapes={"dahl.s": 0.02})
    offered = ForceLibrary("others", (EVERY["dahl"],))
    tree = discover(run, BASE.select(KNOWN), offered)
    monkeypatch.setattr(OmnibusTest, "widening", lambda test, level: 1.0)
    plain = discover(run, BASE.select(KNOWN), offered)
    factor = tree["omnibus"].widening.values
    assert discovery_json(tree)["error_widening"] == factor[-1]
    assert f"errors are widened by the RMS of these scores, {factor[-1]:.3g}" in " ".join(
        verdict_sentences(tree)
    )
    assert tree.attrs["verdict"] == "unknown effect"
    assert factor[-1] > 1.5
    for group, at, names in (
        ("before", 0, ["standard_error", "reference_frequency_standard_error"]),
        ("after", -1, ["standard_error", "reference_frequency_standard_error", "shape_standard_error"]),
        ("steps", -1, ["standard_error", "shape_standard_error"]),
    ):
        for name in names:
            wide, narrow = tree[group][name].values, plain[group][name].values
            assert wide == pytest.approx(factor[at] * narrow), (group, name)
    tree["omnibus"] = type(tree)(tree["omnibus"].to_dataset().drop_vars("widening"))
    assert error_widening(tree) == 1.0, "as an older version has saved it"
