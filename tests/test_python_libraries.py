"""Force libraries from Python, and methods and libraries of other installed packages."""

import subprocess
import sys

import numpy as np
import pytest

import sysid_trib as st
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.library import library_of_text
from sysid_trib.forces.selection import known_coefficients
from sysid_trib.results.models import library_of

TIME = np.arange(0.0, 8.0, 0.02)
ANGLE = 0.3 * np.exp(-0.09 * TIME) * np.cos(9.0 * TIME) + 1e-4 * np.random.default_rng(0).standard_normal(400)
HYSTERETIC = {
    "formula": "z",
    "state": {"z": "(v - abs(v)*z)/s"},
    "shape": {"s": {"default": 0.01, "low": 1e-4, "high": 0.3}},
    "name": "presliding hysteresis",
}


def test_a_library_of_formulas_is_that_of_a_file():
    made = st.library({"lambda": "sign(v)"}, zeta="2*v", mine=HYSTERETIC)
    assert made.symbols == ("lambda", "zeta", "mine")
    assert made["mine"].shape["s"].default == 0.01
    assert library_of_text(made.to_toml(), "").forces == made.forces
    assert made["zeta"].formula == st.load_library()["zeta"].formula


def test_libraries_add():
    shipped, own = st.load_library(), st.library(mine="x**5")
    both = shipped + own
    assert both.symbols == (*shipped.symbols, "mine")
    assert both + shipped == both
    assert (own + shipped["zeta"]).symbols == ("mine", "zeta")
    with pytest.raises(UsageError, match=r"Two different forces have the symbol 'zeta' \(2\*v and v\)"):
        shipped + st.library(zeta="v")


def test_a_force_takes_the_symbol_that_it_is_given():
    renamed = st.library(drag=st.load_library()["delta"])["drag"]
    assert (renamed.symbol, renamed.formula.text) == ("drag", "v*abs(v)")


def test_coefficients_stated_in_a_users_library_are_fixed_also_in_a_sum():
    own = st.library(mine={"formula": "x**5", "coefficient": 2.0})
    assert known_coefficients(own) == {"mine": 2.0}
    assert known_coefficients(st.library("gravity")) == {}
    assert known_coefficients(st.load_library("candidate_effects") + own) == {"mine": 2.0}


def test_a_result_keeps_a_library_made_in_python():
    result = st.identify((TIME, ANGLE), st.library(zeta="2*v", mine="x**5"), "direct")
    assert library_of(result)["mine"].formula.text == "x**5"
    assert result.coefficient.sel(force="zeta").item() == pytest.approx(0.01, abs=1e-4)


PACKAGE = """
from dataclasses import dataclass
import sysid_trib as st
from sysid_trib.methods import Direct, MethodScope

gel = st.library(gel="x**7", viscous="2*v")

@dataclass(frozen=True)
class Mine:
    scope = MethodScope("mine")
    def identify(self, decay, library):
        return Direct(refine=False).identify(decay, library).assign_attrs(method="mine", options="{}")

number = 3
"""
ENTRY_POINTS = """
[sysid_trib.methods]
Mine = its_package:Mine
[sysid_trib.libraries]
gel = its_package:gel
foam = its_package:number
gone = its_package:nothing
"""
USED = """
import numpy as np
import sysid_trib as st
from sysid_trib.errors import SysidTribError
from sysid_trib.methods import method_of
from sysid_trib.validation.compare import every_method

record = tuple(np.load("record.npy"))
result = st.identify(record, "gel", "mine")
print(result.attrs["method"], *result.force.values, type(method_of(result)).__name__)
print("Mine" in dir(st.methods), "mine" in every_method(), st.methods.Mine.__module__)
for name in ("foam", "gone"):
    try:
        st.load_library(name)
    except SysidTribError as error:
        print(error)
"""


def test_methods_and_libraries_come_from_other_packages(tmp_path):
    (tmp_path / "its_package.py").write_text(PACKAGE)
    about = tmp_path / "its_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: its-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    np.save(tmp_path / "record.npy", [TIME, ANGLE])
    (tmp_path / "used.py").write_text(USED)
    ended = subprocess.run([sys.executable, "used.py"], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    first, second, foam, gone = ended.stdout.splitlines()
    assert first == "mine gel viscous Mine"
    assert second == "True True its_package"
    assert foam.startswith("The entry point 'foam' of sysid_trib.libraries has the type int; it must be a")
    assert gone.startswith("'gone' of its-package cannot be loaded (AttributeError")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"mine": "x**"}, "library\\(...\\), force 'mine': 'x\\*\\*' is not a formula"),
        ({"mine": {"formula": "x", "color": "red"}}, "unknown key 'color'"),
        ({"mine": 3}, "formula must be a text"),
    ],
)
def test_a_bad_formula_is_refused_as_that_of_a_file(wrong, said):
    with pytest.raises(LibraryError, match=said):
        st.library(wrong)
