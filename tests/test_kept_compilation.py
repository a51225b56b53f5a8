"""Cache of the compiler on disk: a damaged file is compiled again."""

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

from sysid_trib.simulation import compiled

SOURCE = "def doubled(x):\n    return 2.0 * x\n"


def fresh_module(folder: Path) -> ModuleType:
    """A module with one function, imported as a new process does."""
    (folder / "small_engine.py").write_text(SOURCE)
    sys.modules.pop("small_engine", None)
    return importlib.import_module("small_engine")


@pytest.mark.parametrize(("ending", "size"), [(".nbi", 0), (".nbi", 7), (".nbc", 0), (".nbc", 500)])
def test_a_file_of_the_cache_that_is_cut_short_is_written_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, size: int
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(compiled, "_folder", lambda: tmp_path / "kept")
    assert compiled.compiled(fresh_module(tmp_path).doubled)(1.5) == 3.0
    (file,) = (tmp_path / "kept").rglob("*" + ending)
    whole = file.stat().st_size
    os.truncate(file, size)
    assert compiled.compiled(fresh_module(tmp_path).doubled)(1.5) == 3.0
    assert file.stat().st_size == whole
    loaded = compiled.compiled(fresh_module(tmp_path).doubled)
    assert loaded(1.5) == 3.0
    assert loaded.stats.cache_hits
