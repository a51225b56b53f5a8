"""A paragraph for the methods section of a paper, with the numbers of a result, and what it cites."""

import re
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.printing.exported import (
    about_the_record,
    equation_latex,
    power_of_ten,
    rounded,
)
from sysid_trib.results.schema import library_of
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation.findings import kept_results, main_result, residual_over_noise
from sysid_trib.validation.verdict import record_noise

# What each method is, in the words of a methods section.
IN_WORDS = {
    "direct": (
        "regression of the equation of motion in weak form with refined instrumental variables"
        r"~\cite{young2011}"
    ),
    "averaging": r"averaging, amplitude decay and frequency shift~\cite{lebot2019}",
    "trajectory": "maximum likelihood of the motion, simulated with its exact switchings",
}
BIBLIOGRAPHY = Path(__file__).with_name("citations.bib")


def methods_text(tree: xr.DataTree) -> str:
    """A paragraph in LaTeX on a result of `identify`, and the equation of its answer."""
    main = main_result(tree)
    records, unit = [tree[group] for group in record_groups(tree)], signal_units(tree)
    rate = 1.0 / float(np.median(np.diff(records[0].time.values)))
    samples = ", ".join(f"{record.sizes['time']:,}" for record in records)
    first = (
        f"{'Free decays' if len(records) > 1 else 'A free decay'} of {samples} samples at {rate:.4g} Hz "
        f"({about_the_record(tree)['window']}) {'were' if len(records) > 1 else 'was'} identified."
    )
    if main is None:
        return f"{first}\nNo method gave a model that follows the record.\n"
    named = kept_results(tree)
    others = [name for name in named if name != main.attrs["method"]]
    # A library is its user's: no letter of a name is a command.
    forces = ", ".join(re.sub(r"[^\w ,().-]", " ", force.name) for force in library_of(main))
    said = [
        first,
        rf"The equation of motion~\cite{{lebot2019}} has the forces {forces}; their coefficients "
        f"come from {IN_WORDS.get(main.attrs['method'], main.attrs['method'])}, in PySINDy's optimisers"
        r"~\cite{kaptanoglu2022} where it is linear.",
    ]
    z = tree["comparison"].z if "z" in tree["comparison"] else None
    if others and z is not None:
        said.append(
            f"They were cross-checked by {IN_WORDS.get(others[0], others[0])}: the largest difference is "
            f"{float(np.nanmax(np.abs(z.values))):.2g} of its error."
        )
    noise = power_of_ten(f"{record_noise(tree):.2g}")
    ratio = residual_over_noise(tree, main.attrs["method"])
    said.append(
        f"The motion of the model leaves {ratio:.3g} times the sensor's noise of ${noise}$ {unit} (RMS)."
        if np.isfinite(ratio)
        else "The motion of the model leaves the record."
    )
    said.append(_errors(main))
    w = rounded(main.reference_frequency.item(), main.reference_frequency_standard_error.item())
    said.append(rf"The coefficients refer to $\omega = {w}$ rad/s; computed with sysid\_trib {__version__}.")
    return "\n".join([*said, "", equation_latex(main), ""])


def _errors(main: xr.Dataset) -> str:
    """What the standard errors hold."""
    if "error_of_model" not in main:
        return "Standard errors are those of the noise."
    return (
        "Standard errors are those of the noise and of the model, the latter by the movement of the "
        r"coefficients between the first, middle and last 70\,\% of the record~\cite{hausman1978}."
    )


def cited(text: str) -> str:
    """The entries of BibTeX that a text cites."""
    entries = BIBLIOGRAPHY.read_text(encoding="utf-8").split("\n\n")
    return "\n\n".join(e.strip() for e in entries if e[e.find("{") + 1 : e.find(",")] in text) + "\n"
