"""In which quantity methods compare a record that holds no angle or displacement."""

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import value_with_error
from sysid_trib.printing.model_verdict import kept_results
from sysid_trib.results.per_run import record_groups


def own_quantity(tree: xr.DataTree) -> list[str]:
    """Which method compares what was measured itself, with the bias that it finds; none of an angle.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`.
    """
    for name, result in kept_results(tree).items():
        if quantity := result.attrs.get("compared_in"):
            units = str(result.bias.attrs["units"])
            pairs = zip(np.ravel(result.bias), np.ravel(result.bias_standard_error), strict=True)
            biases = ", ".join(value_with_error(float(bias), float(error)) for bias, error in pairs)
            times = int(tree[record_groups(tree)[0]].attrs.get("integrations", 0))
            over = {0: "", 1: " over w", 2: " over w^2"}[times]
            return [
                f"{name.capitalize()} compares the {quantity} itself, with a bias of {biases} {units} about "
                f"the mean of its swing; the other method is of the integral, "
                f"residuals are of the {quantity}{over}."
            ]
    return []
