"""Table 1 and the Appendix of Le Bot et al. 2019: the signatures of the six forces, derived from formulas."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from candidates import force

from sysid_trib import load_library
from sysid_trib.cycles.signatures import signature
from sysid_trib.validation.separability import indistinguishable


@dataclass(frozen=True)
class Row:
    symbol: str
    sine: Callable[[float], float]
    cosine: Callable[[float], float]


def zero(a: float) -> float:
    return 0.0


# The paper prints theta' where the viscous formula here is 2 theta'.
TABLE_1 = [
    Row("lambda", lambda a: -2 / np.pi, zero),
    Row("zeta", lambda a: 2 * (-a / 2), zero),
    Row("delta", lambda a: -4 * a**2 / (3 * np.pi), zero),
    Row("alpha", zero, lambda a: a / 2),
    Row("nu", zero, lambda a: 4 * a**2 / (3 * np.pi)),
    Row("epsilon", zero, lambda a: 3 * a**3 / 8),
]


@pytest.mark.parametrize("a", [1e-3, 0.3, 0.7, 1.5])
@pytest.mark.parametrize("row", TABLE_1, ids=lambda row: row.symbol)
def test_signature_is_the_papers(row, a):
    found = signature(load_library()[row.symbol], a)
    assert found.sine.item() == pytest.approx(row.sine(a), rel=1e-12, abs=1e-15)
    assert found.cosine.item() == pytest.approx(row.cosine(a), rel=1e-12, abs=1e-15)


def test_appendix_example_has_the_sine_of_table_1():
    # Printed with cos^2 phi, theta'^2 sgn theta' would have half the sine average printed after it: the
    # averages are right, h(phi) is -a^2 sin^2 phi sgn(sin phi).
    quadratic, positional = (signature(force(f), 0.5).sine.item() for f in ("v**2*sign(v)", "x**2*sign(v)"))
    assert quadratic == pytest.approx(-4 * 0.25 / (3 * np.pi), rel=1e-12)
    assert positional == pytest.approx(-2 * 0.25 / (3 * np.pi), rel=1e-12)


def test_section_2_3_these_two_have_one_signature():
    from sysid_trib.forces.library import parse_library

    formulas = {"delta": "v**2*sign(v)", "positional": "x**2*sign(v)", "zeta": "2*v"}
    library = parse_library({"force": [{"symbol": k, "formula": f} for k, f in formulas.items()]}, "test")
    assert indistinguishable(library, 0.02, 0.3) == [("delta", "positional")]
