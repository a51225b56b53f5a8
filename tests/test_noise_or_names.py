"""Noise of the sensor of a colour that its spectrum did not show is not named as forces."""

import numpy as np
import pytest
from discovery import CONTACT, EFFECTS, exact, model_of
from helpers import decay
from scipy.signal import lfilter

from sysid_trib.discovery.discover import discover
from sysid_trib.likelihood import start_model
from sysid_trib.likelihood.colour import MAX_COLOUR

TIME = np.arange(600) / 20.0


def flicker_noise(count: int, seed: int):
    """1/f noise of unit size."""
    white = np.random.default_rng(seed).standard_normal(4 * count)
    frequency = np.fft.rfftfreq(4 * count)
    frequency[0] = np.inf
    noise = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency))[:count]
    return noise / np.std(noise)


# Of these what is slow was named as an ambient vibration, where its colour without any name is as likely.
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.in_full) for seed in (5, 6, 10))])
def test_slow_noise_is_not_named(seed):
    angle = exact(model_of({"zeta": 4e-3}), TIME) + 2e-3 * flicker_noise(len(TIME), seed)
    found = discover(decay(TIME, angle, seed), CONTACT.select(["zeta"]), EFFECTS)
    assert found.attrs["verdict"] == "nothing missing"


def test_slow_noise_is_tried_where_an_autoregression_is_the_likeliest_of_its_kind(monkeypatch):
    monkeypatch.setattr(start_model, "gain_of_little_colour", lambda deviance, filter_: 0.0)
    angle = exact(model_of({"zeta": 4e-3}), TIME) + 2e-3 * flicker_noise(len(TIME), 0)
    model = start_model.fit_start_model([decay(TIME, angle, 0)], CONTACT.select(["zeta"]).forces, None)
    slow = start_model.recoloured(model)
    assert len(slow.rows[0].path.sensor.filter_) > MAX_COLOUR + 1
    assert slow.deviance < model.deviance - 10.0


def test_a_model_beside_noise_of_the_likeliest_colour_stays_as_it_is():
    angle = exact(model_of({"zeta": 4e-3}), TIME)
    model = start_model.fit_start_model([decay(TIME, angle, 3)], CONTACT.select(["zeta"]).forces, None)
    assert start_model.recoloured(model) is model


@pytest.mark.slow
@pytest.mark.parametrize("order", range(MAX_COLOUR + 1))
def test_the_colour_is_of_the_order_that_the_rows_ask_for(order):
    """Where the first partial autocorrelation shows nothing as well."""
    filter_ = np.zeros(order + 1)
    filter_[[0, -1]] = 1.0, -0.7 if order else 1.0
    white = np.random.default_rng(order).standard_normal(len(TIME))
    noise = 2e-3 * lfilter([1.0], filter_, white)
    angle = exact(model_of({"zeta": 4e-3}), TIME)
    run = decay(TIME, angle, 3).assign(angle=("time", angle + noise))
    model = start_model.fit_start_model([run], CONTACT.select(["zeta"]).forces, None)
    whitening = start_model.recoloured(model).rows[0].path.sensor.filter_
    assert len(whitening) == order + 1
