"""Truth and bounds of the certified decays, and the score of a program's answers."""

import csv
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.datasets.registry import CERTIFIED, certified_rows, published
from sysid_trib.errors import RecordError, UsageError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd

# Columns of a table of answers that must be there; `error` may be.
ANSWER_COLUMNS = ("name", "coefficient", "value")
# Unknowns of the bound that are not scored.
OF_THE_START = ("start_angle", "start_rate")


@cache
def _truths() -> dict[str, dict[str, tuple[float, float]]]:
    """Return value and bound of each unknown, by the names of records."""
    truths: dict[str, dict[str, tuple[float, float]]] = {}
    with (CERTIFIED / "truth.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            truths.setdefault(row["name"], {})[row["quantity"]] = (float(row["value"]), float(row["bound"]))
    return truths


def truth(name: str) -> xr.Dataset:
    """Return the truth of a certified decay and the smallest errors with which it can be found.

    Parameters
    ----------
    name : str
        Name of a certified decay, such as `certified/paper_six_1e-3`.

    Returns
    -------
    Dataset
        `value(quantity)` and `bound(quantity)`, the Cramér-Rao bound of its standard error, for each unknown
        of the bound: coefficients by their symbols, `reference_frequency` (rad/s) unless it is given,
        `start_angle` (rad) and `start_rate` (rad/s) at the first sample. Scalars `reference_frequency` and
        `noise` (rad). Attrs `name`, `equation`, `reference_frequency_is_given` (0 or 1), `seed`.

    Raises
    ------
    UsageError
        There is no such dataset, or it is not a certified one.

    Examples
    --------
    >>> import sysid_trib as st
    >>> truth = st.datasets.truth("certified/viscous_1e-4").sel(quantity="zeta")
    >>> print(f"{truth.value.item():.2f}, found with an error of {truth.bound.item():.1e} at best")
    0.01, found with an error of 5.1e-07 at best
    """
    published(name)
    rows = certified_rows()
    if name not in rows:
        example = next(iter(rows))
        raise UsageError(f"The dataset '{name}' is not certified: its truth is unknown; take {example}.")
    row, of_record = rows[name], _truths()[name]
    values, bounds = np.array(list(of_record.values())).T
    given = bool(row["w_given"])
    frequency = float(row["w_given"]) if given else of_record["reference_frequency"][0]
    return xr.Dataset(
        {
            "value": ("quantity", values, {"long_name": "true value"}),
            "bound": ("quantity", bounds, {"long_name": "Cramér-Rao bound of the standard error"}),
            "reference_frequency": ((), frequency, {"units": "rad/s", "long_name": "reference frequency"}),
            "noise": ((), float(row["noise"]), {"units": "rad", "long_name": "noise of one sample"}),
        },
        {"quantity": list(of_record)},
        {
            "name": name,
            "equation": row["equation"],
            "reference_frequency_is_given": int(given),
            "seed": int(row["seed"]),
        },
    )


def score(answers: "pd.DataFrame | str | os.PathLike[str]") -> "pd.DataFrame":
    """Compare a program's answers on certified decays with the truth, in units of the bounds.

    Parameters
    ----------
    answers : DataFrame or path of a CSV file
        A row for each answer: `name` of the decay, `coefficient` (a symbol of its equation, or
        `reference_frequency`), `value`, and `error`, the standard error that the program states (optional).
        An answer that is missing, or not finite, counts as failed.

    Returns
    -------
    DataFrame
        Index `name`, `coefficient`, every scored one of the decays that were answered; columns `value`,
        `truth`, `bound`, `error_over_bound` = (value - truth) / bound, and `stated_over_bound` = error /
        bound; NaN where an answer is missing.

    Raises
    ------
    UsageError
        There is no such file, or it names a decay or coefficient that does not exist.
    RecordError
        The table has no such columns, a value is not a number, or an answer is given twice.

    Notes
    -----
    The RMS of `error_over_bound` over many records is at least 1 for an unbiased method (Cramér and Rao). For
    a single record it is random.

    Examples
    --------
    An answer that is wrong by 1e-5, twenty times the smallest possible error; the frequency was not answered.

    >>> import pandas as pd
    >>> import sysid_trib as st
    >>> answer = {"name": "certified/viscous_1e-4", "coefficient": "zeta", "value": 0.01001}
    >>> scores = st.datasets.score(pd.DataFrame([answer])).loc["certified/viscous_1e-4"]
    >>> scores.error_over_bound.round(1).to_dict()
    {'zeta': 19.6, 'reference_frequency': nan}
    """
    import pandas as pd

    table = answers if isinstance(answers, pd.DataFrame) else _read_answers(Path(answers))
    given = _answers_by_place(table)
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for name in dict.fromkeys(name for name, _ in given):
        for quantity, (value, bound) in _truths()[name].items():
            if quantity in OF_THE_START:
                continue
            answered, error = given.get((name, quantity), (np.nan, np.nan))
            rows[name, quantity] = {
                "value": answered,
                "truth": value,
                "bound": bound,
                "error_over_bound": (answered - value) / bound,
                "stated_over_bound": error / bound,
            }
    index = pd.MultiIndex.from_tuples(list(rows), names=["name", "coefficient"])
    return pd.DataFrame(list(rows.values()), index=index)


def _read_answers(path: Path) -> "pd.DataFrame":
    import pandas as pd

    if not path.is_file():
        raise UsageError(f"{path}: there is no such file of answers.")
    try:
        return pd.read_csv(path)
    except (ValueError, UnicodeDecodeError) as error:
        raise RecordError(f"{path}: this is no table of answers ({error}); give a CSV file.") from error


def _answers_by_place(table: "pd.DataFrame") -> dict[tuple[str, str], tuple[float, float]]:
    """Return value and stated error of each answer by the name of its decay and its coefficient."""
    columns = ", ".join(ANSWER_COLUMNS)
    if absent := [column for column in ANSWER_COLUMNS if column not in table]:
        raise RecordError(f"The table of answers has no column {absent[0]}; it needs {columns}.")
    if table.empty:
        raise RecordError(f"The table of answers has no row; give one a coefficient, with {columns}.")
    by_place: dict[tuple[str, str], tuple[float, float]] = {}
    for row in table.to_dict("records"):
        name, quantity = str(row["name"]), str(row["coefficient"])
        known = _truths().get(name)
        if known is None:
            nearest = did_you_mean(name, _truths())
            raise UsageError(
                f"There is no certified decay '{name}'.{nearest} sysid-trib datasets lists them."
            )
        scored = [place for place in known if place not in OF_THE_START]
        if quantity not in scored:
            raise UsageError(f"{name} has no coefficient '{quantity}'; it has {', '.join(scored)}.")
        if (name, quantity) in by_place:
            raise RecordError(f"{name}: {quantity} is answered twice; give one row a coefficient.")
        by_place[name, quantity] = _number(row["value"], name), _number(row.get("error", np.nan), name)
    return by_place


def _number(value: Any, name: str) -> float:
    """Return a number; NaN if the cell is empty or infinite."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise RecordError(
            f"{name}: the answer '{value}' is no number; leave it empty if it failed."
        ) from None
    return number if np.isfinite(number) else np.nan
