"""Other methods for a free decay, each behind `(library, w, time, angle) -> values, standard errors`.

The forces are those of a library and w is known to all. Errors are nan where a method states none. pysindy
identifies the same forces alone: what the direct method is compared with.
"""

import math
import warnings
from functools import partial

import numpy as np
import pysindy
import scipy.linalg
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import hilbert, savgol_coeffs, savgol_filter

from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.pysindy_features import ForceFeatures

# Best for the paper's run of the windows from 0.15 to 0.45 s and orders tried: bias and noise about equal.
WINDOW, ORDER = 0.25, 6
WEAK_WINDOW, WEAK_ROWS, WEAK_ORDER, WEAK_SMOOTHING = 0.35, 1000, 8, 0.15


Answer = tuple[np.ndarray, np.ndarray]


def without_errors(values: np.ndarray) -> Answer:
    """Return values without standard errors."""
    return values, np.full(len(values), np.nan)


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
) -> Answer:
    """Coefficients by `pysindy.SINDy` from pointwise derivatives."""
    x, rate, acceleration = derivatives(time, angle)
    model = pysindy.SINDy(feature_library=ForceFeatures(library), optimizer=plain_optimizer())
    target = acceleration / w**2 + x
    model.fit(np.column_stack([x, rate / w]), t=time[1] - time[0], x_dot=target[:, None])
    return without_errors(-model.coefficients()[0])


def weak_sindy(library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray, seed=0) -> Answer:
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
    return without_errors(values)


# WENDy: multiples of the smallest radius, and the part of the test functions' information that is kept.
SCALES, KEPT = (1, 2, 4), 0.95
TURNS, SETTLED = 30, 1e-6
# Widths of the local polynomial whose rate WENDy's columns take, in samples, and its order.
RATE_WIDTH, RATE_ORDER = 13, 4
# Part of a record at each end that the Hilbert transform bends.
BENT = 0.05


def bumps(radius: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Test functions exp(-9/(1 - s^2)) of a radius in samples, one a row, and their second derivatives."""
    s = np.arange(-radius, radius + 1) / radius
    inside = np.clip(1.0 - s**2, 1e-12, None)
    bump = np.where(np.abs(s) < 1.0, np.exp(9.0 - 9.0 / inside), 0.0)
    first = -18.0 * s / inside**2
    second = bump * (first**2 - 18.0 / inside**2 - 72.0 * s**2 / inside**3)
    starts = range(0, count - 2 * radius, max(1, radius // 4))
    rows, bent = np.zeros((2, len(starts), count))
    for row, start in enumerate(starts):
        rows[row, start : start + 2 * radius + 1] = bump
        bent[row, start : start + 2 * radius + 1] = second / radius**2
    return rows, bent


def smallest_radius(angle: np.ndarray) -> int:
    """Return the radius at which the error of the quadrature stops falling.

    The rows' own sums of bumps times the record that no smooth motion has: those at a frequency of aliasing
    (Bortz, Messenger, Dukic 2023, section 2.3). Its logarithm has a corner, found by two straight lines.
    """
    radii = np.unique(np.geomspace(4, len(angle) // 12, 24).astype(int))
    spectrum = np.abs(np.fft.rfft(angle - angle.mean()))
    errors = []
    for radius in radii:
        bump = bumps(radius, 2 * radius + 2)[0][0]
        response = np.abs(np.fft.rfft(bump, len(angle)))
        aliased = response[-len(response) // 4 :].max() * spectrum.max()
        errors.append(np.log(aliased + 1e-14 * spectrum.max()))
    cost = []
    for corner in range(2, len(radii) - 2):
        lines = [np.polyfit(np.log(radii[p]), np.array(errors)[p], 1, full=True) for p in _parts(corner)]
        cost.append(sum(float(line[1][0]) if len(line[1]) else 0.0 for line in lines))
    return int(radii[2 + int(np.argmin(cost))])


def _parts(corner: int) -> tuple[slice, slice]:
    return slice(None, corner + 1), slice(corner, None)


def wendy(library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray) -> Answer:
    """Weak form whose rows are weighed by the noise of both sides (Bortz, Messenger, Dukic 2023).

    Test functions of several radii are made orthonormal, the covariance of the rows is that of the noise
    passed through the equation as it stands (its derivatives by angle and rate), and coefficients and
    covariance are taken in turn. Written for a system of second order, of which the angle is measured.
    """
    step, count, radius = time[1] - time[0], len(angle), smallest_radius(angle)
    pairs = [bumps(min(scale * radius, count // 3), count) for scale in SCALES]
    test, bent = (np.vstack([pair[at] for pair in pairs]) for at in range(2))
    u, sizes, _ = np.linalg.svd(test, full_matrices=False)
    kept = int(np.searchsorted(np.cumsum(sizes) / sizes.sum(), KEPT)) + 1
    turn = (u[:, :kept] / sizes[:kept]).T
    test, bent = turn @ test, turn @ bent / step**2
    rate = np.zeros((count, count))
    for at in range(count):
        begin = min(max(at - RATE_WIDTH // 2, 0), count - RATE_WIDTH)
        rate[at, begin : begin + RATE_WIDTH] = savgol_coeffs(
            RATE_WIDTH, RATE_ORDER, deriv=1, delta=step, pos=at - begin, use="dot"
        )
    x, v = angle, rate @ angle / w
    columns = -(w**2) * test @ np.column_stack([force.value(x, v) for force in library])
    target = bent @ angle + w**2 * test @ angle
    by_x, by_v = (np.column_stack(_slopes(library, x, v, at)) for at in range(2))
    plain, by_rate = bent + w**2 * test, rate / w
    values = np.linalg.lstsq(columns, target, rcond=None)[0]
    for _ in range(TURNS):
        operator = plain + w**2 * (test * (by_x @ values) + (test * (by_v @ values)) @ by_rate)
        covariance = operator @ operator.T
        ridge = 1e-12 * np.trace(covariance) / len(covariance)
        factor = scipy.linalg.cholesky(covariance + ridge * np.eye(len(covariance)), lower=True)
        white, aimed = (scipy.linalg.solve_triangular(factor, a, lower=True) for a in (columns, target))
        before, values = values, np.linalg.lstsq(white, aimed, rcond=None)[0]
        if np.linalg.norm(values - before) < SETTLED * np.linalg.norm(values):
            break
    noise = np.sum((aimed - white @ values) ** 2) / (len(aimed) - len(values))
    return values, np.sqrt(noise * np.diag(np.linalg.inv(white.T @ white)))


def _slopes(library: ForceLibrary, x: np.ndarray, v: np.ndarray, by: int) -> list[np.ndarray]:
    """Derivatives of the forces by angle or rate, central differences; kinks have none."""
    small = 1e-6 * np.abs((x, v)[by]).max()
    up, down = ((x + s, v) if by == 0 else (x, v + s) for s in (small, -small))
    slopes = [(force.value(*up) - force.value(*down)) / (2 * small) for force in library]
    return [np.where(np.abs(slope) * small > 0.1, 0.0, slope) for slope in slopes]


def hilbert_backbone(library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray) -> Answer:
    """Amplitude and frequency of the analytic signal, fitted by the forces' averages (Feldman 1994)."""
    signal = hilbert(angle - angle.mean())
    kept = slice(int(BENT * len(time)), int((1.0 - BENT) * len(time)))
    width = 2 * round(2.0 * np.pi / w / (time[1] - time[0])) + 1
    smooth = partial(np.convolve, v=np.ones(width) / width, mode="same")
    amplitude, phase = np.abs(signal), np.unwrap(np.angle(signal))
    frequency = smooth(np.gradient(phase, time))[kept]
    decay = smooth(np.gradient(np.log(amplitude), time))[kept]
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    levels = np.geomspace(amplitude[kept].min(), amplitude[kept].max(), 40)
    columns = []
    for force in library:
        pulls = [force.value(a * np.cos(turn), -a * np.sin(turn)) for a in levels]
        damped = [w * np.mean(p * np.sin(turn)) / a for p, a in zip(pulls, levels, strict=True)]
        stiffer = [w * np.mean(p * np.cos(turn)) / a for p, a in zip(pulls, levels, strict=True)]
        at = np.log(amplitude[kept])
        columns.append(np.concatenate([np.interp(at, np.log(levels), c) for c in (damped, stiffer)]))
    target = np.concatenate([decay, frequency - w])
    return without_errors(np.linalg.lstsq(np.column_stack(columns), target, rcond=None)[0])


def shooting(library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray) -> Answer:
    """`scipy.optimize.least_squares` over `solve_ivp`, from what SINDy says."""
    forces = list(library)
    written = " + ".join(f"p[{at}]*({force.formula.text})" for at, force in enumerate(forces))
    pull = eval(
        f"lambda p, x, v: {written}",
        {"sign": lambda q: (q > 0) - (q < 0), "abs": abs, "exp": math.exp, "sin": math.sin},
    )

    def motion(parameters: np.ndarray) -> np.ndarray:
        coefficients, start = parameters[:-3].tolist(), parameters[-3:-1]

        def rates(t: float, state: np.ndarray) -> list[float]:
            x, v = state.tolist()
            return [w * v, -w * (x + pull(coefficients, x, v))]

        found = solve_ivp(rates, (time[0], time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-11)
        full = np.full(len(time), 10.0)
        full[: found.y.shape[1]] = found.y[0]
        return full + parameters[-1]

    guess, _ = DECAY_PEERS["pysindy.SINDy, Savitzky-Golay"](library, w, time, angle)
    guess = np.append(guess, [angle[0], 0.0, 0.0])
    fitted = least_squares(
        lambda p: motion(p) - angle, guess, x_scale=np.abs(guess) + 0.01, diff_step=1e-4, max_nfev=60
    )
    variance = 2.0 * fitted.cost / (len(time) - len(guess))
    errors = np.sqrt(variance * np.diag(np.linalg.pinv(fitted.jac.T @ fitted.jac)))
    return fitted.x[:-3], errors[:-3]


DECAY_PEERS = {
    "pysindy.SINDy, Savitzky-Golay": partial(sindy, derivatives=inner_savitzky_golay),
    "pysindy.WeakPDELibrary": weak_sindy,
    "WENDy (ours, after the paper)": wendy,
    "Hilbert backbone (FREEVIB)": hilbert_backbone,
    "scipy shooting, from SINDy": shooting,
}
