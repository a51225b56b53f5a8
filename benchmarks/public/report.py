"""Scores by the official metrics, tables, and the fields of a submission to nonlinearbenchmark.org."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sysid_trib as st
from benchmarks.public.downloads import error_metrics
from benchmarks.public.models import Chosen
from benchmarks.public.signals import Array, Split, Test
from benchmarks.study.common import shown
from sysid_trib.errors import RecordError

WIDTH = 180
LINK = "https://github.com/sysid-trib/sysid_trib"
TITLE = "sysid_trib: forces of a driven oscillator by their names"
AUTHORS = "sysid_trib contributors"
MODEL_CLASS = "physical (grey-box) continuous-time model of second order"


@dataclass(frozen=True)
class Reporting:
    """How a benchmark's RMSE is reported.

    Parameters
    ----------
    unit : str
    per_unit : float
        Factor from the unit of the output.
    digits : str
        Format of the number to submit.
    source : str
        Where unit and format are from.
    """

    unit: str
    per_unit: float
    digits: str
    source: str


@dataclass(frozen=True)
class Score:
    """Scores of one test by `nonlinear_benchmarks.error_metrics`; the first samples do not count.

    Parameters
    ----------
    test : str
    rmse, mae : float
        In the unit in which the benchmark is reported.
    nrmse, r_squared : float
    fit_index : float, %
    samples : int
        Samples that count.
    submitted : bool
        Whether the RMSE is one of those to submit.
    """

    test: str
    rmse: float
    mae: float
    nrmse: float
    r_squared: float
    fit_index: float
    samples: int
    submitted: bool = True


def score(test: Test, run: Array, reporting: Reporting) -> Score:
    """Return the scores of a free run.

    Raises
    ------
    RecordError
        The package `nonlinear_benchmarks` is not installed.
    """
    metrics = error_metrics()
    # As in the official templates: both are cut before, so that each metric sees the same samples.
    y_true = test.counted
    y_model = run[test.start_samples :]
    return Score(
        test=test.name,
        rmse=reporting.per_unit * float(metrics.RMSE(y_true, y_model)),
        mae=reporting.per_unit * float(metrics.MAE(y_true, y_model)),
        nrmse=float(metrics.NRMSE(y_true, y_model)),
        r_squared=float(metrics.R_squared(y_true, y_model)),
        fit_index=float(metrics.fit_index(y_true, y_model)),
        samples=len(y_true),
        submitted=test.submitted,
    )


def to_submit(scores: Sequence[Score], reporting: Reporting) -> str:
    """Return the RMSE as the official templates print them: `[a; b; c]`, or one number."""
    numbers = [format(one.rmse, reporting.digits) for one in scores if one.submitted]
    return numbers[0] if len(numbers) == 1 else f"[{'; '.join(numbers)}]"


@dataclass(frozen=True, eq=False)
class Answer:
    """Everything that is reported on one benchmark."""

    title: str
    split: Split
    chosen: Chosen
    scores: tuple[Score, ...]
    reporting: Reporting

    def show(self) -> None:
        """Print the choice, the scores, and the numbers to submit."""
        unit = self.reporting.unit
        print(f"\n{self.title}: {self.split.said}; {self.chosen.said}.")
        trials = [
            (
                one.candidate.name,
                str(one.candidate.parameters),
                one.reason or f"{self.reporting.per_unit * one.error:.4g}",
            )
            for one in self.chosen.trials
        ]
        shown(
            "Candidates, on the training part alone",
            ("forces", "parameters", f"held out, RMSE ({unit})"),
            trials,
            WIDTH,
        )
        rows = [
            (
                one.test,
                f"{one.rmse:.4g}",
                f"{one.nrmse:.5f}",
                f"{one.r_squared:.6f}",
                f"{one.mae:.4g}",
                f"{one.fit_index:.3f}",
                str(one.samples),
            )
            for one in self.scores
        ]
        heads = ("test", f"RMSE ({unit})", "NRMSE", "R^2", f"MAE ({unit})", "fit index (%)", "samples")
        shown(f"{self.title}: free runs", heads, rows, WIDTH)
        count = self.chosen.trial.candidate.parameters
        print(f"{count} parameters; training {self.chosen.seconds:.0f} s (processor time).")
        if self.split.official:
            print(f"RMSE to submit = {to_submit(self.scores, self.reporting)}")
        else:
            print("These are not the official tests: not to be submitted.")

    def fields(self) -> dict[str, Any]:
        """Return the fields of a submission."""
        return {
            "benchmark": self.title,
            "official_tests": self.split.official,
            "title": TITLE,
            "authors": AUTHORS,
            "model_class": MODEL_CLASS,
            "model": self.chosen.trial.candidate.name,
            "number_of_parameters": self.chosen.trial.candidate.parameters,
            "training_time_s": round(self.chosen.seconds, 1),
            "training": self.split.said,
            "choice_of_model": self.chosen.said,
            "unit": self.reporting.unit,
            "RMSE": {one.test: one.rmse for one in self.scores},
            "RMSE_to_submit": to_submit(self.scores, self.reporting) if self.split.official else None,
            "other_scores": {
                one.test: {
                    "NRMSE": one.nrmse,
                    "R_squared": one.r_squared,
                    "MAE": one.mae,
                    "fit_index": one.fit_index,
                    "samples": one.samples,
                }
                for one in self.scores
            },
            "link": LINK,
            "version": st.__version__,
            "format": self.reporting.source,
        }


def write(answers: Sequence[Answer], path: Path) -> None:
    """Write the fields of all answers as JSON.

    Raises
    ------
    RecordError
        The file cannot be written.
    """
    text = json.dumps([one.fields() for one in answers], indent=2, allow_nan=False)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordError(
            f"{path}: cannot be written ({error.strerror}); name another file by --out."
        ) from None
