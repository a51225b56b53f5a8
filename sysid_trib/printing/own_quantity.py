"""In which quantity methods compare a record that holds no angle or displacement."""

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import value_with_error
from sysid_trib.printing.model_verdict import kept_results


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
            return [
                f"{name.capitalize()} compares the {quantity} itself, with a bias of {biases} {units} about "
                "the mean of its swing; the other method and the residuals are those of the integral."
            ]
    return []
