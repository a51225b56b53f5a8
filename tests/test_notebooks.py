"""Notebooks are kept as text and notebook in step, the first with outputs, and use public names only."""

import ast
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import nbformat
import pytest

import sysid_trib

FOLDER = Path(__file__).parents[1] / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
NAMESPACES = (
    "campaigns",
    "control",
    "datasets",
    "forces",
    "methods",
    "physics",
    "plots",
    "records",
    "validation",
)
OFFERED = {
    "st": {*dir(sysid_trib), *NAMESPACES},
    **{f"st.{name}": set(import_module(f"sysid_trib.{name}").__all__) for name in NAMESPACES},
}


def of_scripts(function):
    return pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)(function)


def test_a_text_belongs_to_every_notebook():
    assert SCRIPTS
    assert [script.stem for script in SCRIPTS] == sorted(n.stem for n in FOLDER.glob("*.ipynb"))


@of_scripts
def test_the_notebook_is_the_text(script):
    spec = spec_from_file_location("pair", FOLDER / "pair.py")
    pair = module_from_spec(spec)
    spec.loader.exec_module(pair)
    stored = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    for cell in stored.cells:
        if cell.cell_type == "code":
            cell |= {"outputs": [], "execution_count": None}
    assert stored == nbformat.reads(pair.notebook_text(script), as_version=4), (
        "write it again: python notebooks/pair.py"
    )


@of_scripts
def test_the_first_notebooks_have_outputs_and_the_others_none(script):
    cells = nbformat.read(script.with_suffix(".ipynb"), as_version=4).cells
    code = [cell for cell in cells if cell.cell_type == "code"]
    assert code
    rendered = script.stem[:2] in ("01", "02", "03")
    # Imports print nothing.
    assert any(cell.outputs for cell in code) == all(cell.execution_count for cell in code) == rendered
    assert not any(output.output_type == "error" for cell in code for output in cell.outputs)


@of_scripts
def test_the_notebook_uses_public_names(script):
    tree = ast.parse(script.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not node.module.startswith("sysid_trib"), ast.unparse(node)
        elif isinstance(node, ast.Import):
            ours = [(name.name, name.asname) for name in node.names if name.name.startswith("sysid_trib")]
            assert ours in ([], [("sysid_trib", "st")]), ast.unparse(node)
        elif isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_"), ast.unparse(node)
            offered = OFFERED.get(ast.unparse(node.value))
            assert offered is None or node.attr in offered, ast.unparse(node)


@of_scripts
def test_long_computations_are_shortened_by_one_visible_line(script):
    first_cells = script.read_text(encoding="utf-8").split("# %%")[:4]
    assert "SYSID_TRIB_QUICK" in "".join(first_cells)


def run(folder, *names):
    return subprocess.run([sys.executable, folder / "run.py", *names], capture_output=True, text=True)


@pytest.mark.slow
def test_a_notebook_that_fails_is_named_with_its_cell(tmp_path):
    shutil.copy(FOLDER / "run.py", tmp_path)
    cells = [nbformat.v4.new_code_cell(source) for source in ("print('good')", "1 / 0", "2")]
    for name, some in (("01_fails", cells), ("02_works", cells[:1])):
        nbformat.write(nbformat.v4.new_notebook(cells=some), tmp_path / f"{name}.ipynb")
    done = run(tmp_path)
    assert done.returncode == 1
    assert "01_fails.ipynb, code cell 2 of 3: " in done.stderr
    assert "ZeroDivisionError" in done.stderr
    assert "02_works: done" in done.stdout
    executed = nbformat.read(tmp_path / "executed" / "02_works.ipynb", as_version=4)
    assert executed.cells[0].outputs[0].text == "good\n"
    assert run(tmp_path, "02_works").returncode == 0


def test_a_record_that_cannot_be_had_is_reported_in_one_sentence(monkeypatch, capsys):
    def refuse(name):
        raise sysid_trib.errors.RecordError(f"dataset {name}: no connection.")

    spec = spec_from_file_location("tables", FOLDER / "tables.py")
    tables = module_from_spec(spec)
    spec.loader.exec_module(tables)
    monkeypatch.setattr(sysid_trib.datasets, "load", refuse)
    assert tables.available("ship_roll") is None
    said = "dataset ship_roll: no connection. The cells that need it are skipped.\n"
    assert capsys.readouterr().out == said
