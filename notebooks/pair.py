"""Write each notebook NAME.ipynb from its text NAME.py: python notebooks/pair.py.

The first three are kept with the outputs of their last run, `python notebooks/run.py NAME`.
"""

from pathlib import Path

import jupytext
import nbformat

HERE = Path(__file__).parent
RENDERED = ("01_six_forces", "02_paper_experiment", "03_two_identifications")
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}


def scripts() -> list[Path]:
    """Texts of the notebooks, 01_*.py to 99_*.py, in reading order."""
    return sorted(HERE.glob("[0-9][0-9]_*.py"))


def notebook_text(script: Path) -> str:
    """The notebook that belongs to a text; the same text gives the same notebook."""
    notebook = jupytext.read(script)
    notebook.metadata = nbformat.from_dict({"kernelspec": KERNEL})
    for number, cell in enumerate(notebook.cells):
        # Random identities would change with every writing.
        cell.id = f"cell-{number}"
        # Lines that a function is set off by in the text.
        cell.source = cell.source.strip("\n")
    nbformat.validate(notebook)
    return nbformat.writes(notebook) + "\n"


def with_outputs(text: str, script: Path) -> str:
    """The notebook with the outputs of the last run of the same text, or those that it has."""
    notebook = nbformat.reads(text, as_version=4)
    sources = [cell.source for cell in notebook.cells]
    for run in (HERE / "executed" / f"{script.stem}.ipynb", script.with_suffix(".ipynb")):
        cells = nbformat.read(run, as_version=4).cells if run.exists() else []
        if [cell.source for cell in cells] == sources and any(cell.get("outputs") for cell in cells):
            for cell, executed in zip(notebook.cells, cells, strict=True):
                cell |= {key: executed[key] for key in ("outputs", "execution_count") if key in executed}
            return nbformat.writes(notebook) + "\n"
    return text


def main() -> None:
    for script in scripts():
        beside = script.with_suffix(".part")
        text = notebook_text(script)
        beside.write_text(with_outputs(text, script) if script.stem in RENDERED else text, encoding="utf-8")
        beside.replace(script.with_suffix(".ipynb"))


if __name__ == "__main__":
    main()
