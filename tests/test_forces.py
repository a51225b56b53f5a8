import json
from pathlib import Path

import pytest
from candidates import CANDIDATES, candidate, force
from helpers import library_of_formulas
from hypothesis import given, strategies as st

from sysid_trib import load_library
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.library import MAX_BYTES

# symbol: parity, character, degree, degree in v, units
PROPERTIES = {
    "lambda": ("odd", "dissipative", 0, 0, "1"),
    "zeta": ("odd", "dissipative", 1, 1, "1"),
    "delta": ("odd", "dissipative", 2, 2, "1"),
    "alpha": ("odd", "conservative", 1, 0, "1"),
    "epsilon": ("odd", "conservative", 3, 0, "1"),
    "stribeck": ("odd", "dissipative", None, None, "1"),
    "magnet": ("odd", "conservative", None, 0, "1"),
    "wall": ("mixed", "conservative", None, 0, "1"),
    "even_friction": ("even", "dissipative", 1, 0, "1"),
    "drift": ("odd", "dissipative", None, 1, "s-1"),
    "ambient": ("even", "conservative", None, 0, "1"),
    "maxwell": ("odd", "mixed", None, None, "1"),
    "jenkins": ("odd", "mixed", None, 0, "1"),
    "scale": ("odd", "sensor", 3, 0, "1"),
}
LATEX = {
    "lambda": r"\operatorname{sgn}{\left(\theta' \right)}",
    "epsilon": r"\theta^{3}",
    "stribeck": r"\operatorname{sgn}{\left(\theta' \right)}\,e^{- \frac{\theta'^{2}}{s^{2}}}",
    "freeplay": r"\operatorname{sgn}{\left(\theta \right)}\,\max\left(0, - g + \left|{\theta}\right|\right)",
    "magnet": r"- \theta + \frac{\sin{\left(2\,\theta \right)}}{2}",
    "jenkins": r"\max\left(- s, \min\left(s, \theta - xr + zr\right)\right)",
}
HOSTILE = [
    "__import__('os').system('touch pwned')",
    "open('pwned', 'w')",
    "eval('1')",
    "x.__class__",
    "().__class__.__bases__[0].__subclasses__()",
    "x[0]",
    "lambda: x",
    "[x for x in (1,)]",
    "(y := x)",
    "yield",
    "'x'",
    "f'{x}'",
    "x if v else t",
    "x < v",
    "~x",
    "x // v",
    "True",
    "import os",
    "x = v",
]
MALFORMED = ["", "x +", "x\x00", "y", "nan", "θ", "sign", "sign(x, v)", "min(x)", "sin(x=1)", "exp(x)(v)"]
HEAVY = [
    "9**9**9",
    "x**25",
    "x**v",
    "x**(1/2)",
    "1e101*x",
    "9" * 400 + "*x",
    "+".join(["x"] * 240),
    "-" * 490 + "x",
    "abs(" * 31 + "x" + ")" * 31,
    "(" * 249 + "x" + ")" * 249 + "+1",
]
NOT_FINITE = ["exp(800*x)", "sqrt(x)", "1/(x - x)", "x/0", "0**-1*x", "x*1e99*1e99*1e99*1e99"]
WRONG = {
    "unknown key": {"color": "red"},
    "symbol with a space": {"symbol": "a b"},
    "symbol of dunders": {"symbol": "__class__"},
    "formula not a text": {"formula": 3},
    "unknown kind": {"kind": "torque"},
    "passive not a truth value": {"passive": "yes"},
    "coefficient not a number": {"coefficient": "one"},
    "coefficient of nothing": {"coefficient": 0.0},
    "state not a table": {"state": "z"},
    "state named x": {"state": {"x": "v"}},
    "hostile state": {"state": {"z": "__import__('os')"}},
    "state not finite": {"state": {"z": "v/0"}},
    "state and memory of one name": {"state": {"z": "v"}, "memory": {"z": "x"}},
    "start without memory": {"start": {"m": "x"}},
    "sensor with a state": {"kind": "sensor", "state": {"z": "v"}},
    "shape without range": {"shape": {"s": {"default": 1.0}}},
    "shape out of range": {"shape": {"s": {"default": 2.0, "low": 0.1, "high": 1.0}}},
    "shape with more": {"shape": {"s": {"default": 1, "low": 0, "high": 2, "unit": "m"}}},
}
FILES = {
    "empty": b"",
    "not TOML": b"this is no TOML",
    "no forces": b'title = "nothing"',
    "forces not tables": b"force = [1, 2]",
    "binary": bytes(range(256)) * 4,
    "wrong encoding": '[[force]]\nsymbol = "g"\nformula = "x" # é'.encode("latin-1"),
    "huge": b"#" * (MAX_BYTES + 1),
    "deep": b"a = " + b"[" * 5000,
    "two of a symbol": b'[[force]]\nsymbol = "g"\nformula = "x"\n[[force]]\nsymbol = "g"\nformula = "v"',
    "no formula": b'[[force]]\nsymbol = "g"',
}


def by_symbol(symbol):
    return candidate(symbol) if symbol in CANDIDATES else load_library()[symbol]


def refused(path: Path) -> str:
    with pytest.raises(LibraryError) as caught:
        load_library(path)
    message = str(caught.value)
    assert message.startswith(path.name)
    assert "\n" not in message
    assert len(message) < 350
    return message


def written(path: Path, parts: dict) -> Path:
    lines = [f"{key} = {toml(value)}" for key, value in parts.items()]
    path.write_text("\n".join(["[[force]]", *lines]), encoding="utf-8")
    return path


def toml(value) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)


@pytest.mark.parametrize("symbol", PROPERTIES)
def test_properties_follow_from_the_formula(symbol):
    found = by_symbol(symbol)
    assert (found.parity, found.character, found.degree, found.speed_degree, found.units) == PROPERTIES[
        symbol
    ]


@pytest.mark.parametrize("symbol", LATEX)
def test_latex(symbol):
    assert by_symbol(symbol).latex == LATEX[symbol]


def test_roles_are_known_by_formula_not_by_symbol():
    six = load_library()
    assert six.role("x").symbol == "alpha"
    assert six.role("abs(v)*v").symbol == "delta"
    assert six.role("v**3") is None
    assert not force("tanh(v/0.001)").matches("sign(v)")
    assert not force("x", kind="sensor").matches("x")


def test_unknown_symbol_and_library_are_usage_errors():
    with pytest.raises(UsageError, match="no force 'mu'; it has lambda"):
        load_library()["mu"]
    with pytest.raises(UsageError, match="no library 'nothing'"):
        load_library("nothing")


def test_five_lines_are_a_library(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        '[[force]]\nsymbol = "mu"\nname = "friction that grows outwards"\n'
        'formula = "x**2*sign(v)"\nsource = "my thesis"\n'
    )
    found = load_library(path)["mu"]
    assert (found.parity, found.character, found.degree) == ("odd", "dissipative", 2)
    assert found.value(0.5, -0.1) == -0.25
    assert found.source == "my thesis"
    assert load_library(str(path)).symbols == ("mu",)


@pytest.mark.parametrize("formula", [*HOSTILE, *MALFORMED, *HEAVY, *NOT_FINITE])
def test_bad_formula_is_refused_and_not_executed(formula, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    message = refused(written(tmp_path / "lib.toml", {"symbol": "g", "formula": formula}))
    assert "force 'g'" in message or "TOML" in message
    assert not Path("pwned").exists()


@pytest.mark.parametrize("case", WRONG)
def test_wrong_entry_is_refused(case, tmp_path):
    refused(written(tmp_path / "lib.toml", {"symbol": "g", "formula": "x"} | WRONG[case]))


@pytest.mark.parametrize("case", FILES)
def test_wrong_file_is_refused(case, tmp_path):
    path = tmp_path / "lib.toml"
    path.write_bytes(FILES[case])
    refused(path)


@given(st.text(alphabet="xvt()+-*/., 0123456789eabsigncomp'\"[]{}_:=<>", max_size=40))
def test_any_text_is_a_force_or_one_error(text):
    try:
        found = force(text)
    except LibraryError:
        return
    assert found.parity in ("odd", "even", "mixed")


def test_a_formula_that_ends_somewhere_has_no_degree():
    """log(1.5 - x) is finite at the points where formulas are compared, but not at all multiples of them."""
    force = library_of_formulas(bounded="log(1.5 - x)").forces[0]
    assert force.degree is None
    assert force.speed_degree == 0.0


def test_a_folder_does_not_hide_a_library_of_its_name(tmp_path, monkeypatch):
    (tmp_path / "paper").mkdir()
    (tmp_path / "curves").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_library("paper") == load_library("contact_forces")
    assert load_library("curves").symbols
