"""The same forces identified by pysindy alone: what the direct method is compared with."""

import warnings

import numpy as np
import pysindy
from scipy.signal import savgol_filter

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.pysindy_features import ForceFeatures

# Best for the paper's run of the windows from 0.15 to 0.45 s and orders tried: bias and noise about equal.
WINDOW, ORDER = 0.25, 6
WEAK_WINDOW, WEAK_ROWS, WEAK_ORDER, WEAK_SMOOTHING = 0.35, 1000, 8, 0.15


class _OneRow(ForceFeatures):
    """`WeakPDELibrary` fits its functions on a single state."""

    def fit(self, x, y=None):
        return super().fit(np.atleast_2d(np.asarray(x)), y)


def plain_optimizer() -> pysindy.STLSQ:
    """Least squares: the default threshold of 0.1 would delete lambda, zeta and delta."""
    return pysindy.STLSQ(threshold=0.0, alpha=0.0)


def finite_differences(time: np.ndarray, angle: np.ndarray) -> list[np.ndarray]:
    """Angle, rate and acceleration by pysindy's default differentiation."""
    differentiate = pysindy.FiniteDifference()
    rate = np.asarray(differentiate(angle[:, None], time))[:, 0]
    return [angle, rate, np.asarray(differentiate(rate[:, None], time))[:, 0]]


def savitzky_golay(time: np.ndarray, angle: np.ndarray, window: float = WINDOW) -> list[np.ndarray]:
    """Angle, rate and acceleration of local polynomials over `window` seconds."""
    step = time[1] - time[0]
    width = 2 * round(window / step / 2) + 1
    return [savgol_filter(angle, width, ORDER, deriv=d, delta=step) for d in range(3)]


def inner_savitzky_golay(time: np.ndarray, angle: np.ndarray, window: float = WINDOW) -> list[np.ndarray]:
    """`savitzky_golay` without the ends, where the polynomials are one-sided."""
    half = round(window / (time[1] - time[0]) / 2)
    return [values[half:-half] for values in savitzky_golay(time, angle, window)]


def sindy(
    library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray, derivatives=finite_differences
) -> np.ndarray:
    """Coefficients by `pysindy.SINDy` from pointwise derivatives."""
    x, rate, acceleration = derivatives(time, angle)
    model = pysindy.SINDy(feature_library=ForceFeatures(library), optimizer=plain_optimizer())
    target = acceleration / w**2 + x
    model.fit(np.column_stack([x, rate / w]), t=time[1] - time[0], x_dot=target[:, None])
    return -model.coefficients()[0]


def weak_sindy(library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray, seed=0) -> np.ndarray:
    """Coefficients by `pysindy.WeakPDELibrary`; the library must hold a force of formula `x`.

    The state's rate is that of local polynomials: without smoothing the nonlinear forces are noise.
    """
    _, rate, _ = savitzky_golay(time, angle, WEAK_SMOOTHING)
    np.random.seed(seed)  # noqa: NPY002 (the library draws its windows from numpy's global generator)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        weak = pysindy.WeakPDELibrary(
            function_library=_OneRow(library),
            spatiotemporal_grid=time,
            H_xt=[WEAK_WINDOW],
            K=WEAK_ROWS,
            p=WEAK_ORDER,
        )
        model = pysindy.SINDy(feature_library=weak, optimizer=plain_optimizer())
        model.fit(np.column_stack([angle, rate / w]), t=time[1] - time[0])
    values = -model.coefficients()[1] / w
    values[[f.matches("x") for f in library]] -= 1.0
    return values
