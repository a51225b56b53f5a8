"""Simulated records in the place of the official ones; the integrator shares nothing with the package.

Bouc-Wen is itself a simulated benchmark, with published equations, parameters and signals (Noel and Schoukens
2016): its stand-ins differ from the official tests only by random phases and the integrator.
Silverbox and EMPS are replaced by a Duffing circuit and by a carriage under a cascade controller.
"""

from pathlib import Path

import numpy as np
from numba import njit
from scipy import io, signal

from benchmarks.public.signals import Array, Signals

# Steps of the integration from one sample to the next; the benchmark of Bouc-Wen prescribes 20.
STEPS = 20

BOUC_WEN_RATE = 750.0
PERIOD = 8192
PERIODS = 5
# kg, Ns/m, N/m, N/m, 1/m, 1, 1 (Noel and Schoukens 2016, Table 1); the exponent is 1.
MASS, DAMPING, STIFFNESS = 2.0, 10.0, 5e4
ALPHA, BETA, GAMMA, DELTA = 5e4, 1e3, 0.8, -1.1
# m: what the measured training record leaves from its simulation by these equations.
BOUC_WEN_NOISE = 7.3e-6

# A Duffing circuit of the size of Silverbox: x''/w^2 + 2 zeta x'/w + x + even x^2 + cubic x^3 = gain u.
CIRCUIT_RATE = 610.35
CIRCUIT_FREQUENCY = 2.0 * np.pi * 68.6
CIRCUIT_DAMPING, CIRCUIT_GAIN = 0.047, 0.99
CIRCUIT_CUBIC, CIRCUIT_EVEN = 3.98, -0.096
CIRCUIT_NOISE = 2e-4
CIRCUIT_SAMPLES = 131_072

# kg, Ns/m, N, N: published least squares of EMPS (Janot, Gautier and Brunot 2019); its drive and gains.
CARRIAGE_MASS, CARRIAGE_VISCOUS, CARRIAGE_DRY, CARRIAGE_OFFSET = 95.11, 203.5, 20.39, -3.16
CARRIAGE_DRIVE, CARRIAGE_POSITION_GAIN, CARRIAGE_RATE_GAIN = 35.15065188248547, 160.18, 243.45
CARRIAGE_RATE = 1000.0
CARRIAGE_SAMPLES = 24_841
# V, and m: the limit of the voltage, and the step of the encoder.
LARGEST_VOLTAGE = 10.0
ENCODER_STEP = 1e-6


@njit
def _bouc_wen_rates(y, v, z, u):
    acceleration = (u - DAMPING * v - STIFFNESS * y - z) / MASS
    return v, acceleration, ALPHA * v - BETA * (GAMMA * abs(v) * z + DELTA * v * abs(z))


@njit
def _duffing_rates(x, v, unused, u):
    restoring = x + CIRCUIT_EVEN * x**2 + CIRCUIT_CUBIC * x**3
    damping = 2.0 * CIRCUIT_DAMPING * v / CIRCUIT_FREQUENCY
    return v, CIRCUIT_FREQUENCY**2 * (CIRCUIT_GAIN * u - restoring - damping), 0.0


@njit
def _integrated(rates, u, step):
    """Integrate by the classical rule of Runge and Kutta; `u` has two values a step."""
    count = len(u) // 2
    out = np.empty(count)
    y, v, z = 0.0, 0.0, 0.0
    for at in range(count):
        out[at] = y
        begin, middle = u[2 * at], u[2 * at + 1]
        end = u[min(2 * at + 2, len(u) - 1)]
        a1, b1, c1 = rates(y, v, z, begin)
        a2, b2, c2 = rates(y + 0.5 * step * a1, v + 0.5 * step * b1, z + 0.5 * step * c1, middle)
        a3, b3, c3 = rates(y + 0.5 * step * a2, v + 0.5 * step * b2, z + 0.5 * step * c2, middle)
        a4, b4, c4 = rates(y + step * a3, v + step * b3, z + step * c3, end)
        y += step * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        v += step * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0
        z += step * (c1 + 2.0 * c2 + 2.0 * c3 + c4) / 6.0
    return out


def _responses(rates, u: Array, rate: float) -> Array:
    """Return the response from rest to an input with `2 * STEPS` values a sample, at the samples."""
    return _integrated(rates, u, 1.0 / (rate * STEPS))[::STEPS]


def _finer(period: Array, times: int) -> Array:
    """Return a period of a periodic, band-limited signal with `times` as many samples."""
    return np.asarray(signal.resample(period, times * len(period)))


def _multisine(lines: Array, samples: int, rms: float, random: np.random.Generator) -> Array:
    """Return a period of a random-phase multisine of equal amplitudes."""
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * random.random(len(lines)))
    period = np.fft.irfft(spectrum)
    return rms * period / np.std(period)


def _bouc_wen_period(seed: int) -> Array:
    """Return a period of the multisine from 5 to 150 Hz, 50 N (RMS)."""
    resolution = BOUC_WEN_RATE / PERIOD
    lines = np.arange(int(5.0 / resolution), int(np.ceil(150.0 / resolution)) + 1)
    return _multisine(lines, PERIOD, 50.0, np.random.default_rng(seed))


def bouc_wen_response(period: Array, periods: int) -> Array:
    """Return the response from rest to so many periods of an input that is given at the samples."""
    return _responses(_bouc_wen_rates, np.tile(_finer(period, 2 * STEPS), periods), BOUC_WEN_RATE)


def bouc_wen_training(seed: int = 0) -> Signals:
    """Return the training record of the benchmark's guide: five periods from rest, with noise."""
    period = _bouc_wen_period(seed)
    noise = np.random.default_rng([seed, 1]).standard_normal(PERIODS * PERIOD)
    y = bouc_wen_response(period, PERIODS) + BOUC_WEN_NOISE * noise
    return Signals(np.tile(period, PERIODS), y, 1.0 / BOUC_WEN_RATE)


def bouc_wen_multisine(seed: int = 100) -> Signals:
    """Return a test multisine: one period in the steady state, without noise."""
    period = _bouc_wen_period(seed)
    return Signals(period, bouc_wen_response(period, 3)[-PERIOD:], 1.0 / BOUC_WEN_RATE)


def bouc_wen_sweep() -> Signals:
    """Return a test sweep: 40 N, 20 to 50 Hz at 10 Hz/min, from rest, without noise."""
    seconds = 180.0
    time = np.arange(int(seconds * BOUC_WEN_RATE) * 2 * STEPS) / (2 * STEPS * BOUC_WEN_RATE)
    u = 40.0 * np.sin(2.0 * np.pi * (20.0 * time + 0.5 * (10.0 / 60.0) * time**2))
    return Signals(u[:: 2 * STEPS], _responses(_bouc_wen_rates, u, BOUC_WEN_RATE), 1.0 / BOUC_WEN_RATE)


def circuit_record(seed: int = 0) -> Signals:
    """Return a record of a Duffing circuit laid out as that of Silverbox: the arrow, then ten multisines.

    The arrow is noise below 200 Hz whose amplitude grows in proportion to time, up to 1.5 times the
    multisines' largest value; each multisine has odd lines up to 200 Hz, and 508 zeros before it.
    """
    random = np.random.default_rng(seed)
    u = np.zeros(CIRCUIT_SAMPLES)
    below = signal.butter(9, 180.0, fs=CIRCUIT_RATE, output="sos")
    noise = signal.sosfiltfilt(below, random.standard_normal(40_000))
    arrow = noise * np.arange(40_000) / 40_000
    u[200:40_200] = 0.15 * arrow / np.abs(arrow).max()
    lines = np.arange(1, int(200.0 / CIRCUIT_RATE * PERIOD), 2)
    for at in range(10):
        first = 41_008 + at * 8700
        u[first : first + PERIOD] = _multisine(lines, PERIOD, 0.0222, random)
    y = _responses(_duffing_rates, _finer(u, 2 * STEPS), CIRCUIT_RATE)
    return Signals(u, y + CIRCUIT_NOISE * random.standard_normal(len(y)), 1.0 / CIRCUIT_RATE)


@njit
def _carriage(wanted, pulses, step):
    """Integrate the carriage under its controller; return voltages and positions at the samples."""
    voltages = np.empty(len(wanted))
    positions = np.empty(len(wanted))
    x, v = wanted[0], 0.0
    for at in range(len(wanted)):
        voltage = CARRIAGE_RATE_GAIN * (CARRIAGE_POSITION_GAIN * (wanted[at] - x) - v)
        voltage = min(max(voltage + pulses[at] / CARRIAGE_DRIVE, -LARGEST_VOLTAGE), LARGEST_VOLTAGE)
        voltages[at], positions[at] = voltage, x
        for _ in range(STEPS):
            force = CARRIAGE_DRIVE * voltage - CARRIAGE_OFFSET - CARRIAGE_VISCOUS * v
            if v == 0.0 and abs(force) <= CARRIAGE_DRY:
                continue
            against = CARRIAGE_DRY * (np.sign(v) if v != 0.0 else np.sign(force))
            faster = v + step * (force - against) / CARRIAGE_MASS
            # It comes to rest before it turns round.
            v = 0.0 if faster * v < 0.0 else faster
            x += step * v
    return voltages, positions


def carriage_record(*, pulses: bool) -> tuple[Signals, Array, Array]:
    """Return a record of a carriage (voltage, position), its wanted position, and the pulses (N)."""
    random = np.random.default_rng(8)
    # Moves of constant acceleration and deceleration, of several lengths and durations, with short rests.
    moves = [np.zeros(200)]
    while sum(map(len, moves)) < CARRIAGE_SAMPLES:
        phase = np.linspace(0.0, 1.0, int(random.uniform(400.0, 1500.0)))
        share = np.where(phase < 0.5, 2.0 * phase**2, 1.0 - 2.0 * (1.0 - phase) ** 2)
        begin, end = moves[-1][-1], random.uniform(0.0, 0.24)
        moves += [begin + (end - begin) * share, np.full(100, end)]
    wanted = np.concatenate(moves)[:CARRIAGE_SAMPLES]
    time = np.arange(CARRIAGE_SAMPLES) / CARRIAGE_RATE
    pushed = np.where(np.mod(time, 1.5) > 1.3, 60.0, 0.0) * np.where(np.mod(time, 6.0) > 3.0, -1.0, 1.0)
    pushed = pushed if pulses else np.zeros(len(time))
    voltages, positions = _carriage(wanted, pushed, 1.0 / (CARRIAGE_RATE * STEPS))
    shown = ENCODER_STEP * np.round(positions / ENCODER_STEP)
    return Signals(voltages, shown, 1.0 / CARRIAGE_RATE), wanted, pushed


def write_silverbox(folder: Path) -> None:
    """Write a simulated record under the name and in the layout of the official one."""
    record = circuit_record()
    place = folder / "Silverbox" / "SilverboxFiles"
    place.mkdir(parents=True)
    io.savemat(place / "SNLS80mV.mat", {"V1": record.u[None, :], "V2": record.y[None, :]})


def write_emps(folder: Path) -> None:
    """Write simulated records under the names and in the layout of the official ones."""
    place = folder / "EMPS"
    place.mkdir(parents=True)
    for name, pulses in (("DATA_EMPS", False), ("DATA_EMPS_PULSES", True)):
        record, wanted, pushed = carriage_record(pulses=pulses)
        columns = {"qm": record.y, "qg": wanted, "vir": record.u}
        columns["t"] = record.sampling_time * np.arange(len(record))
        columns |= {"pulses_N": pushed} if pulses else {}
        scalars = {"gtau": CARRIAGE_DRIVE, "kp": CARRIAGE_POSITION_GAIN, "kv": CARRIAGE_RATE_GAIN}
        io.savemat(place / f"{name}.mat", {k: v[:, None] for k, v in columns.items()} | scalars)


def write_bouc_wen(folder: Path) -> None:
    """Write simulated tests under the names and in the layout of the official ones."""
    place = folder / "BoucWen" / "BoucWenFiles" / "Test signals" / "Validation signals"
    place.mkdir(parents=True)
    for name, record in (("multisine", bouc_wen_multisine()), ("sinesweep", bouc_wen_sweep())):
        for prefix, values in (("uval", record.u), ("yval", record.y)):
            io.savemat(place / f"{prefix}_{name}.mat", {f"{prefix}_{name}": values[None, :]})
