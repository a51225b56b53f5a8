"""Tables that several notebooks show, and the records that they need."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

import sysid_trib as st


def available(name: str) -> xr.Dataset | None:
    """Return a record of `st.datasets`; if it cannot be had, say why, and return None."""
    try:
        return st.datasets.load(name)
    except st.errors.RecordError as error:
        print(f"{error} The cells that need it are skipped.")
        return None


def effects_found(tree: xr.DataTree) -> pd.DataFrame:
    """Return one row per effect of a discovery, with the residual before and after it (in noise levels).

    `fit` is the residual on what was fitted, `held out` on what was predicted.
    """
    steps, held = tree["steps"].ds, tree["holdout"].ds
    noise = held.residual_noise.item()
    rows = []
    for at in range(steps.attrs["count"]):
        step = steps.isel(step=at)
        fit, out = (step[f"residual_{when}"].item() / noise for when in ("before", "after")), held.rms / noise
        rows.append(
            {
                "effect": f"{step['symbol'].item()}: {step['formula'].item()}",
                "coefficient": _with_error(step["coefficient"].item(), step["standard_error"].item()),
                "shapes": ", ".join(_shapes(step)),
                "competing": "; ".join(
                    s for s in step.candidate.values[step.credible.values] if s != step["symbol"].item()
                ),
                "fit": " to ".join(f"{residual:.3g}" for residual in fit),
                "held out": " to ".join(f"{residual:.3g}" for residual in out.values[at : at + 2]),
            }
        )
    return pd.DataFrame(rows)


def _shapes(step: xr.Dataset) -> list[str]:
    if "shape" not in step:
        return []
    values = step["shape"].dropna("shape_parameter")
    return [f"{value.shape_parameter.item()} = {value.item():.4g}" for value in values]


def coefficients(results: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Coefficients and shape parameters with their standard errors, one row an identification."""
    rows = {}
    for label, result in results.items():
        each = zip(
            *(result[k].values.tolist() for k in ("force", "coefficient", "standard_error")), strict=True
        )
        rows[label] = {symbol: _with_error(value, error) for symbol, value, error in each}
        names = result.shape_parameter.values.tolist() if "shape" in result else []
        for name in names:
            one = result.sel(shape_parameter=name)
            rows[label][name] = _with_error(one["shape"].item(), one["shape_standard_error"].item())
    return pd.DataFrame.from_dict(rows, orient="index").fillna("")


def random_forces(
    decays: Mapping[str, xr.Dataset], results: Mapping[str, xr.Dataset], ahead: Mapping[str, xr.Dataset]
) -> pd.DataFrame:
    """Both noises of each record, its innovations, and whether its random force depends on nothing."""
    rows = {}
    for label, result in results.items():
        size = np.sqrt(result.random_force_density.item()) / result.reference_frequency.item() ** 2
        tested, data = st.validation.random_force_dependence(decays[label], result), ahead[label]
        rows[label] = {
            "sensor's noise (mrad)": f"{1e3 * result.noise.item():.3g}",
            "random force over w² (1/√Hz)": f"{size:.2g}",
            "innovations (mrad)": f"{1e3 * data.innovation_rms.item():.3g}",
            "largest autocorrelation": f"{np.abs(data.autocorrelation.values).max():.2f}",
            "p of white innovations": f"{data.ljung_box_p_value.item():.2g}",
            "p of a force that depends on nothing": f"{tested.p_value.item():.2g}",
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def _with_error(value: float, error: float) -> str:
    """A value to the second digit of its error; one without error was held."""
    if not np.isfinite(error):
        return f"{value:.5g} (held)"
    digits = max(0, 1 - int(np.floor(np.log10(error)))) if error > 0.0 else 6
    return f"{value:.{digits}f} ± {error:.{digits}f}"
