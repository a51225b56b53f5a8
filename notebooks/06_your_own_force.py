# %% [markdown]
# # A force of your own
#
# A force is a few lines of text. The package derives what it needs from the formula: the signature (the
# effect on envelope and frequency), the exact motion, the column of the regression, parity, unit and
# label. This notebook goes from the lines to an identification, with a shape parameter, an internal state,
# and an error of the sensor. Every record is *synthetic*: simulated, with white noise added.

# %%
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import tables
import xarray as xr
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
pd.set_option("display.max_colwidth", None)
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # shorter records
FOLDER = TemporaryDirectory()

# %% [markdown]
# ## Five lines
#
# Eddy currents brake an aluminium disc that turns between magnets: in proportion to its speed while it is
# slow, and less and less when it is fast. No library of the package has this force. The disc has two more
# forces.

# %%
BRAKE = """
title = "A disc between magnets"

[[force]]
symbol = "brake"
name = "eddy-current brake"
formula = "v/(1 + (v/s)**2)"
shape = { s = { default = 0.2, low = 0.02, high = 2.0, meaning = "speed of the largest drag (rad)" } }

[[force]]
symbol = "friction"
formula = "sign(v)"

[[force]]
symbol = "spring"
formula = "x**3"
"""


def library_of(text: str, name: str = "mine.toml") -> st.forces.ForceLibrary:
    """The library that a text declares."""
    path = Path(FOLDER.name) / name
    path.write_text(text, encoding="utf-8")
    return st.load_library(path)


disc = library_of(BRAKE)
brake = disc["brake"]
print(f"{brake.parity}, {brake.character}, unit of the coefficient {brake.units}; in LaTeX {brake.latex}")

# %% [markdown]
# `x` is the angle, `v` the angular rate over the reference frequency w, both in rad; `t` is the time in s.
# The shape parameter `s` is inside the formula, the coefficient is in front of it. On the command line
# `sysid-trib forces` shows a library, and the forces that averaging cannot separate:


# %%
def command_line(*arguments: str) -> subprocess.CompletedProcess[str]:
    """`sysid-trib` in the folder, its output plain text 110 characters wide."""
    plain = os.environ | {"FORCE_COLOR": "", "COLUMNS": "110"}
    asked = [sys.executable, "-m", "sysid_trib", *arguments]
    return subprocess.run(asked, cwd=FOLDER.name, env=plain, capture_output=True, text=True, check=False)


print(command_line("forces", "mine.toml").stdout)

# %% [markdown]
# ## Its signature
#
# Over a cycle $x = a\cos\varphi$, $v = -a\sin\varphi$ a force acts by two averages: $\langle
# h\sin\varphi\rangle$ drives the amplitude, $\langle h\cos\varphi\rangle$ the frequency. For this force
# the first can be derived by hand, with $k = a/s$:
#
# $$\langle h\sin\varphi\rangle = -\frac{a}{k^2}\left(1 - \frac{1}{\sqrt{1 + k^2}}\right)$$

# %%
amplitude = np.linspace(0.01, 1.0, 100)
found = {
    f"brake, s = {s:g} rad": st.forces.signature(brake, amplitude, {"brake.s": s}) for s in (0.1, 0.2, 0.4)
}
found["spring"] = st.forces.signature(disc["spring"], amplitude)
k = amplitude / 0.2
by_hand = -amplitude / k**2 * (1.0 - 1.0 / np.sqrt(1.0 + k**2))
print(
    f"Largest difference from the formula: {np.abs(found['brake, s = 0.2 rad'].sine - by_hand).max():.1e} rad"
)
both = xr.concat(found.values(), pd.Index(found, name="force"))
figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for panel, average in zip(panels, ("sine", "cosine"), strict=True):
    both[average].plot.line(x="amplitude", ax=panel)

# %% [markdown]
# For viscous friction this would be an inclined straight line, for dry friction a horizontal one. The drag
# of a slow disc looks viscous, that of a fast one decreases: this distinguishes the brake from the usual
# frictions.
#
# ## Its motion
#
# A model is a library, coefficients, and a reference frequency. The motion is exact, with switching and
# sticking at their true times. The code adds noise.

# %%
FREQUENCY, NOISE, SECONDS = 9.0, 2e-4, 15.0 if QUICK else 25.0  # rad/s, rad, s


def record_of(model: st.Model, angle: float = 0.6, seed: int = 0) -> xr.Dataset:
    """A synthetic record at 50 Hz: the model's motion from rest at `angle` (rad), and white noise."""
    time = np.arange(0.0, SECONDS, 0.02)
    return st.simulate(model, time, angle)[["angle"]] + NOISE * np.random.default_rng(seed).standard_normal(
        time.size
    )


TRUTH = {"brake": 0.03, "friction": 3e-4, "spring": -0.1}
model = st.Model(disc, TRUTH, FREQUENCY, {"brake.s": 0.25})
decay = st.free_decay(record_of(model))
predicted = st.physics.predict_envelope(model, decay.time.values, amplitude=0.6)
display(st.plots.motions(decay, {"averaged envelope": predicted}).figure)

# %% [markdown]
# ## Identification
#
# Averaging and direct identification hold shape parameters at a given value or at the default. The
# trajectory fit can identify them. The default here is 0.2 rad, the truth 0.25 rad:

# %%
m = st.methods
ASKED = {
    "direct, s held at the default": m.Direct(),
    "trajectory, s fitted": m.Trajectory(fit_shapes=("brake.s",)),
}
results = {label: st.identify(decay, disc, method) for label, method in ASKED.items()}
s = {"brake.s": results["trajectory, s fitted"]["shape"].sel(shape_parameter="brake.s").item()}
for label, method in (("direct", m.Direct(shapes=s)), ("averaging", m.Averaging(shapes=s))):
    results[f"{label}, s held at that"] = st.identify(decay, disc, method)


display(tables.coefficients(results))
print("In truth:", TRUTH | model.shapes)

# %% [markdown]
# At the wrong value, direct identification attributes a part of the brake to dry friction. The cross-check
# detects this: it simulates both models and shows their residuals.

# %%
wrong = {
    label: st.identify(decay, disc, method)
    for label, method in (("averaging", m.Averaging()), ("direct", m.Direct()))
}
checks = {
    "s at the default": st.cross_check(decay, wrong["averaging"], wrong["direct"]),
    "s as found": st.cross_check(
        decay, results["averaging, s held at that"], results["direct, s held at that"]
    ),
}
for label, tree in checks.items():
    judged = tree["judged"].ds
    residuals = ", ".join(f"{ratio:.3g}" for ratio in judged.residual_over_noise.values)
    print(f"{label}: {judged.attrs['verdict']}; RMS residuals {residuals} times the noise")
display(st.plots.overview(checks["s as found"]))

# %% [markdown]
# ## Forces with the same signature
#
# Different formulas may have signatures that differ only by a factor. Averaging cannot separate them on
# any record. Regression of the angle itself may, because it uses the harmonics.

# %%
SAME_SIGNATURE = """
title = "Three frictions"
[[force]]
symbol = "speed_cubed"
formula = "v**3"
[[force]]
symbol = "film"
formula = "x**2*v"
[[force]]
symbol = "viscous"
formula = "2*v"
"""
three = library_of(SAME_SIGNATURE)
print("Averaging cannot separate:", st.forces.indistinguishable(three, 0.05, 0.6))
truth = {"viscous": 0.006, "speed_cubed": 0.02}
both = record_of(st.Model(three, truth, FREQUENCY), seed=1)
try:
    st.identify(both, three, m.Averaging())
except ValueError as error:
    print("Averaging:", error)
display(tables.coefficients({"direct": st.identify(both, three, m.Direct())}))
print("In truth:", truth)

# %% [markdown]
# ## A history-dependent force
#
# An oil film warms as it is sheared, and thins. Its warmth z is a state with the formula dz/d(wt): heating
# by v^2 and cooling with the time constant s/w, here some seconds. The film is cold at the release: z
# starts from zero.

# %%
FILM = """
title = "An oil film that warms"
[[force]]
symbol = "viscous"
formula = "2*v"

[[force]]
symbol = "warming"
name = "viscosity that changes with warmth"
formula = "z*v"
state = { z = "(v**2 - z)/s" }
shape = { s = { default = 60.0, low = 5.0, high = 500.0, meaning = "thermal time times frequency" } }

[[force]]
symbol = "speed_cubed"
formula = "v**3"
"""
film = library_of(FILM)
truth = {"viscous": 0.012, "warming": -0.15}
cooling = record_of(st.Model(film, truth, FREQUENCY, {"warming.s": 40.0}), seed=2)
warm, instant = film.select(["viscous", "warming"]), film.select(["viscous", "speed_cubed"])
found = {"trajectory, s fitted": st.identify(cooling, warm, m.Trajectory(fit_shapes=("warming.s",)))}
s = {"warming.s": found["trajectory, s fitted"]["shape"].item()}
found["direct, s held at that"] = st.identify(cooling, warm, m.Direct(shapes=s))
found["averaging, s held at that"] = st.identify(cooling, warm, m.Averaging(shapes=s))
found["trajectory, warmth without delay"] = st.identify(cooling, instant, m.Trajectory())
fits = {label: result for label, result in found.items() if "trajectory" in label}
residuals = pd.Series({label: fit.residual_rms.item() / NOISE for label, fit in fits.items()})
display(tables.coefficients(found))
print("In truth:", truth | {"warming.s": 40.0})
display(residuals.round(2).to_frame("RMS residual of the trajectory, over the noise"))

# %% [markdown]
# A film whose warmth follows the speed at once (`v**3`) does not explain the record; the state does.
# Averaging assumes the steady cycle of a history-dependent force. A film that starts cold is not in this
# cycle: averaging is wrong by many of its errors, and the simulated models show it:

# %%
tree = st.cross_check(cooling, found["averaging, s held at that"], found["direct, s held at that"])
ratios = tree["judged"].residual_over_noise.to_series()
print("RMS residuals over the noise:", ", ".join(f"{label} {ratio:.3g}" for label, ratio in ratios.items()))

# %% [markdown]
# ## An error of the sensor
#
# A sensor may not measure the angle itself. With `kind = "sensor"` a formula is added to the reading, not
# to the motion. A camera in front of a pendulum measures the chord, sin(x), not the arc: a part of this
# error, `sin(x) - x`, resembles a spring. Methods identify forces alone; `discover` also offers errors of
# the sensor.

# %%
CHORD = """
title = "A camera, or a spring"
[[force]]
symbol = "viscous"
formula = "2*v"

[[force]]
symbol = "chord"
name = "arc read as a chord"
formula = "sin(x) - x"
kind = "sensor"

[[force]]
symbol = "spring"
formula = "x**3"

[[force]]
symbol = "inertia"
formula = "x*v**2"
"""
camera, TILT = library_of(CHORD), 0.5
filmed = record_of(st.Model(camera, {"viscous": 0.01, "chord": TILT}, FREQUENCY), seed=3)
seen = st.discover(filmed, camera.select(["viscous"]), camera.select(["chord", "spring", "inertia"]))
step, held = seen["steps"].ds.isel(step=0), seen["holdout"].ds
value, error = step["coefficient"].item(), step["standard_error"].item()
print(f"{seen.attrs['search_outcome']}: {step['symbol'].item()} = {value:.4f} ± {error:.1g}; in truth {TILT}")
residuals = (held.rms / held.residual_noise).values.round(2)
print("Residual of the held-out third, over the noise, before and after:", residuals)
display(st.plots.ranking(seen))

# %% [markdown]
# ## Errors in a library
#
# Formulas are read by a whitelist: nothing in a file is ever executed, so that a library from anyone is
# safe to load. An error is one sentence that says what is wrong, where, and what to do.

# %%
LINE = '[[force]]\nsymbol = "mine"\nformula = "{}"\n'
BAD = {
    "a name that is not known": LINE.format("velocity**2"),
    "something that is not a formula": LINE.format("__import__('os').remove('record.csv')"),
    "a part missing": LINE.format("sign(v"),
    "no formula": '[[force]]\nsymbol = "mine"\n',
    "a logarithm of negative angles": LINE.format("log(x)"),
    "a misspelt key": LINE.format("sign(v)") + 'fomula = "x"\n',
    "the same symbol twice": LINE.format("sign(v)") + LINE.format("x**3"),
    "a default beyond its limits": LINE.format("tanh(v/s)")
    + "shape = { s = { default = 5.0, low = 0.1, high = 1.0 } }\n",
    "a sensor with a state": LINE.format("z") + 'kind = "sensor"\nstate = { z = "v - z" }\n',
    "no TOML at all": "sign(v)",
}
for what, text in BAD.items():
    try:
        library_of(text)
    except ValueError as error:
        print(f"{what}:\n    {error}")

# %% [markdown]
# On the command line the same sentence goes to stderr, with exit status 1 (2 for a file that does not
# exist):

# %%
for name in ("mine.toml", "yours.toml"):
    ended = command_line("forces", name)
    print(ended.returncode, ended.stderr.strip())
FOLDER.cleanup()
