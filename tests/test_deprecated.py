"""A deprecated name works, warns with its replacement where it is used, and is not listed."""

import importlib
import warnings

import pytest

STUB = """
from fractions import Fraction as Fraction
__all__ = ["Fraction"]
__deprecated__ = {"Ratio": "Fraction"}
"""
INIT = """
from sysid_trib._lazy import public_names
__getattr__, __dir__, __all__ = public_names(__name__, __file__)
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a deprecated name."""
    folder = tmp_path / "renamed_names"
    folder.mkdir()
    (folder / "__init__.pyi").write_text(STUB, encoding="utf-8")
    (folder / "__init__.py").write_text(INIT, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("renamed_names")
    monkeypatch.delitem(importlib.sys.modules, "renamed_names")


def test_an_old_name_is_the_new_one_and_warns_each_time(package):
    for _ in range(2):
        with pytest.warns(
            DeprecationWarning, match=r"renamed_names\.Ratio .* use renamed_names\.Fraction\."
        ) as seen:
            assert package.Ratio is package.Fraction
        assert [warning.filename for warning in seen] == [__file__]


def test_an_import_warns_where_it_stands(package):
    with pytest.warns(DeprecationWarning, match="use renamed_names") as seen:
        from renamed_names import Ratio  # noqa: F401
    assert {warning.filename for warning in seen} == {__file__}


def test_the_new_name_does_not_warn_and_the_old_one_is_not_listed(package):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert package.Fraction(1, 2) == 0.5
    assert dir(package) == package.__all__ == ["Fraction"]
