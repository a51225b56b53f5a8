"""The Birge ratio: by how much residuals exceed what the errors explain."""

import numpy as np


def birge_ratio(chi_square: float, degrees_of_freedom: int) -> float:
    """Root of the reduced chi-square (Birge 1932); 1 where the model leaves but the noise.

    Parameters
    ----------
    chi_square : float
        Sum of the squared residuals over their standard errors.
    degrees_of_freedom : int
        Number of residuals without that of the parameters.
    """
    return float(np.sqrt(chi_square / max(1, degrees_of_freedom)))
