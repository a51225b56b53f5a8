"""Exported tables and equations contain the numbers of the result."""

import csv
import io
import json
import re

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_csv
from helpers import FIVE, W, decay, measured, paper_run
from known_results import PAPER, known

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.printing.equation import equation_latex, equation_text
from sysid_trib.printing.exported import cited, csv_text, latex_text, methods_text, unit_in_latex
from sysid_trib.results.references import with_contactless_frequency

FORCES = st.load_library()
ERRORS = np.diag([1e-6, 1e-4, 1e-3, 1e-3, 5e-3, 1e-3]) ** 2


def balanced(text):
    return all(
        text.count(a) == text.count(b) for a, b in (("{", "}"), (r"\begin", r"\end"), (r"\left", r"\right"))
    )


def test_the_equation_is_the_model():
    result = known(PAPER, ERRORS)
    inside = re.search(r"x'' = -w\^2 \((.*)\), v = x'/w, w = ([\d.]+) rad/s", equation_text(result))
    x, v = np.array([0.1, -0.2, 0.3]), np.array([0.3, 0.1, -0.2])
    total = eval(inside[1], {"x": x, "v": v, "sign": np.sign, "abs": np.abs})
    model = st.physics.model_of(result)
    forces = [model.coefficients[force.symbol] * force.value(x, v) for force in model.library]
    expected = x + np.sum(forces, axis=0)
    np.testing.assert_allclose(total, expected, atol=1e-3)
    assert float(inside[2]) == pytest.approx(W, abs=1e-2)


def test_a_stiffness_that_is_in_the_frequency_is_not_in_the_equation():
    result = with_contactless_frequency(known(PAPER, ERRORS), 8.87, 0.01)
    assert "alpha" in result.force
    assert equation_text(result) == equation_text(known(PAPER, ERRORS))


def test_the_equation_for_latex_is_balanced_and_has_no_e():
    text = equation_latex(known(PAPER, ERRORS))
    assert balanced(text)
    assert r"\times 10^{-5}" in text
    assert not re.search(r"\de[-+]?\d", text)
    assert text.count(r"\quad") == len(PAPER)


@pytest.fixture(scope="module")
def tree():
    record = paper_run(FIVE, sampling_rate=50.0).decay(7)
    pair = [method.identify(record, FORCES) for method in (st.methods.Averaging(), st.methods.Direct())]
    return st.cross_check(record, *pair)


def test_a_table_holds_all_digits(tree):
    rows = list(csv.DictReader(io.StringIO(csv_text(tree))))
    found = {(row["method"], row["quantity"]): row for row in rows}
    for name in ("averaging", "direct"):
        for symbol in FIVE:
            force = tree[name].to_dataset().sel(force=symbol)
            row = found[name, symbol]
            assert float(row["value"]) == force.coefficient.item()
            assert float(row["standard_error"]) == force.standard_error.item()
        assert float(found[name, "asymptotic_frequency"]["value"]) == tree[name].asymptotic_frequency.item()
    assert {row["error_of_model"] for row in rows if row["formula"]} == {"0.0"}
    assert found["record", "verdict"]["value"] == "explained"


def test_a_table_for_latex(tree):
    text = latex_text(tree)
    assert balanced(text)
    assert text.startswith("\\begin{table}\n\\centering\n\\caption{Coefficients by averaging and direct with")
    caption = text.partition(r"\caption{")[2].partition("\n")[0]
    samples = tree["record"].sizes["time"]
    for words in (
        "Verdict: explained",
        f"samples: {samples}",
        "window: 0 to",
        "units: rad",
        "times the noise",
    ):
        assert words in caption
    assert r"\begin{tabular}{lcc}" in text
    assert " & averaging & direct " in text
    lines = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0].strip().splitlines()
    assert all(line.count("&") == 2 and line.endswith(r"\\") for line in lines)
    assert len(lines) == len(FIVE) + 2


def test_shapes_stand_in_table_csv_and_equation(tmp_path):
    """All of them have the value: an equation without it is incomplete."""
    library = tmp_path / "own.toml"
    peak = st.load_library("candidate_effects")["stribeck"]
    offered = st.forces.ForceLibrary("own", (*FORCES.select(["lambda", "zeta"]), peak))
    library.write_text(offered.to_toml(), encoding="utf-8")
    record = paper_run({"lambda": 5e-4, "zeta": 0.01}, sampling_rate=50.0, duration=10.0).decay(7)
    write_csv(tmp_path / "a.csv", record.time, record.angle)
    table, text = tmp_path / "a_table.csv", tmp_path / "a.tex"
    asked = ["--library", library, "--set", "stribeck.s=0.05", "--random-force", "off"]
    assert run("identify", tmp_path / "a.csv", *asked, "--csv", table, "--latex", text).status == 0
    with table.open(encoding="utf-8") as file:
        row = next(row for row in csv.DictReader(file) if row["quantity"] == "stribeck.s")
    assert (row["value"], row["standard_error"], row["constraint"]) == ("0.05", "", "fixed")
    written = text.read_text(encoding="utf-8")
    assert "s &= 0.05\n" in written
    assert "{stribeck.s}$ & $0.05$ (held)" in written


def test_figures_have_the_width_that_is_asked_for(tmp_path):
    path = write_csv(tmp_path / "swing.csv", time=np.arange(0.0, 12.0, 0.02))
    ending = run("backbone", path, "--plot", tmp_path / "figures", "--width", "88")
    assert ending.status == 0, ending.err
    png = (tmp_path / "figures" / "backbone.png").read_bytes()
    # Pixels of an image of 300 in an inch, in its header.
    assert int.from_bytes(png[16:20], "big") == int(300 * 88 / 25.4)


def test_a_displacement_is_written_with_its_unit_and_is_no_angle():
    time = np.arange(900) / 60.0
    record = decay(time, 24.0 * np.exp(-0.05 * time) * np.cos(8.0 * time), 1, 1e-2, "mm")
    forces = FORCES.select(["lambda", "zeta", "delta"])
    text = latex_text(st.compare(st.free_decay(record), forces, [st.methods.Direct()]))
    assert r"$\mathrm{mm}^{-1}$" in text
    assert r"\ddot{x}" in text
    assert "theta" not in text
    # No power outside of mathematics.
    assert not re.search(r"mm\^", text)
    assert unit_in_latex("mm^-1 s-1") == r"$\mathrm{mm}^{-1}\,\mathrm{s}^{-1}$"


def test_a_mass_and_a_load_make_forces_of_a_displacement(tmp_path):
    time = np.arange(700) / 60.0
    model = st.Model(FORCES, {"lambda": 2e-3, "zeta": 5e-3, "delta": 0.02}, 8.0)
    record = decay(time, 24.0 * st.simulate(model, time, angle=0.4).angle.values, 1, 2e-3)
    path = write_csv(tmp_path / "slider.csv", time, record.angle.values, "time (s),x (mm)")
    words = ("identify", path, "--forces", "lambda,zeta,delta", "--mass", "0.5", "--load", "2")
    told = json.loads(run(*words, "--json").out)["si_units"]
    assert [told[s]["unit"] for s in told] == ["N", "kg s^-1", "kg m^-1"]
    # m w^2 lambda, 2 m w zeta, m delta; 24 mm count as one radian in the model.
    expected = {"lambda": 0.5 * 64 * 2e-3 * 0.024, "zeta": 2 * 0.5 * 8 * 5e-3, "delta": 0.5 * 0.02 / 0.024}
    for symbol, value in expected.items():
        assert abs(told[symbol]["value"] - value) < 5.0 * told[symbol]["standard_error"] < 0.2 * value
    assert told["lambda"]["friction_coefficient"]["value"] == pytest.approx(told["lambda"]["value"] / 2.0)


@pytest.mark.slow
def test_torques_and_friction_with_their_errors_stand_in_table_csv_and_latex(tmp_path):
    path = write_csv(tmp_path / "swing.csv", time=np.arange(0.0, 12.0, 0.02))
    places = {flag: tmp_path / f"result.{flag}" for flag in ("csv", "tex", "nc")}
    si = ("--inertia", "0.012±0.0002", "--load", "2+-0.01", "--radius", "0.001")
    words = ("identify", path, "--forces", "lambda,zeta,delta", *si, "--scale", "1±0.003")
    ending = run(*words, "--csv", places["csv"], "--latex", places["tex"], "-o", places["nc"])
    assert ending.status == 0, ending.err
    assert "friction coefficient" in ending.out
    assert "inertia 0.01200 ± 0.00020 kg m2" in ending.out
    assert "N m s rad-1" in ending.out
    assert "Errors include that of the scale" in ending.out
    rows = list(csv.DictReader(io.StringIO(places["csv"].read_text())))
    of_zeta, in_si = (
        [r for r in rows if r["quantity"] == "zeta" and r["unit"] == u] for u in ("1", "N m s rad-1")
    )
    w = next(
        float(r["value"]) for r in rows if r["quantity"] == "reference_frequency" and r["method"] == "direct"
    )
    assert float(in_si[0]["value"]) == pytest.approx(2.0 * 0.012 * w * float(of_zeta[-1]["value"]), rel=1e-9)
    assert float(in_si[0]["standard_error"]) >= 0.0002 / 0.012 * abs(float(in_si[0]["value"]))
    friction, torque = (
        next(r for r in rows if r["quantity"] == "lambda" and r["name"] == name and "SI" in r["method"])
        for name in ("friction coefficient", "")
    )
    assert float(friction["value"]) == pytest.approx(float(torque["value"]) / (2.0 * 0.001), rel=1e-9)
    text = places["tex"].read_text()
    assert balanced(text)
    assert r"$\mu_{\lambda}$" in text
    assert "load: $2.000 \\pm 0.010$" in text
    again = run("report", places["nc"], "-o", tmp_path / "page.html")
    assert again.status == 0, again.err
    assert "SI unit" in (tmp_path / "page.html").read_text()


def test_the_error_of_the_scale_goes_with_the_power_of_the_amplitude(tmp_path):
    # A record with a scale error of 2 % is compared with the stated errors of the result.
    time = np.arange(0.0, 12.0, 0.02)
    model = st.Model(FORCES, {"lambda": 1e-3, "zeta": 5e-3, "delta": 0.04, "nu": -0.3, "epsilon": 0.3}, 8.0)
    record = measured(model, time, 0.4, noise=1e-6, seed=1)
    library = FORCES.select(["lambda", "zeta", "delta", "nu", "epsilon"])
    found = [
        st.identify(record.assign(angle=s * record.angle), library, st.methods.Direct()) for s in (1.0, 1.02)
    ]
    moved = np.abs(found[1].coefficient / found[0].coefficient - 1.0).values
    whole = st.physics.with_scale_error(found[0], 0.02)
    stated = (whole.error_of_calibration / abs(whole.coefficient)).values
    np.testing.assert_allclose(stated, [0.02, 0.0, 0.02, 0.02, 0.04])
    np.testing.assert_allclose(moved, stated, rtol=0.05, atol=1e-3)
    square = found[0].standard_error ** 2 + whole.error_of_calibration**2
    np.testing.assert_allclose(whole.standard_error**2, square)
    np.testing.assert_allclose(np.diag(whole.covariance), whole.standard_error**2)
    # By the command the record is multiplied.
    path = write_csv(tmp_path / "swing.csv", time, record.angle.values)
    words = ("identify", path, "--forces", ",".join(library.symbols), "--json", "--scale", "1.02±0.02")
    told = json.loads(run(*words).out)["methods"]["direct"]["coefficients"]
    values = [told[symbol]["value"] for symbol in library.symbols]
    np.testing.assert_allclose(values, found[1].coefficient.values, rtol=2e-3)
    assert told["epsilon"]["error_of_calibration"] == pytest.approx(0.04 / 1.02 * values[-1], rel=1e-6)
    with pytest.raises(UsageError, match="relative error"):
        st.physics.with_scale_error(found[0], -1.0)


def test_texts_of_files_are_neither_commands_of_latex_nor_formulas_of_spreadsheets(tree):
    assert unit_in_latex(r"$\si{V}$") == r"$\mathrm{\$\backslash si\{V\}\$}$"
    assert unit_in_latex("a&b^-1 50%") == r"$\mathrm{a\&b}^{-1}\,\mathrm{50\%}$"
    hostile = tree.copy()
    direct = hostile["direct"].to_dataset()
    hostile["direct"] = xr.DataTree(direct.assign_coords(unit=("force", ["=1+1"] * direct.sizes["force"])))
    rows = [row for row in csv.DictReader(io.StringIO(csv_text(hostile))) if row["method"] == "direct"]
    assert {row["unit"] for row in rows} == {"'=1+1", "rad/s"}
    assert all(float(row["value"]) == float(row["value"]) for row in rows)


def test_a_methods_paragraph_has_its_numbers_and_references(tmp_path, tree):
    text = methods_text(tree)
    assert text.count("{") == text.count("}")
    keys = set(re.findall(r"\\cite\{(\w+)\}", text))
    bibliography = cited(text)
    assert keys == set(re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE))
    assert f"{tree['record'].sizes['time']:,} samples" in text
    assert "of its error" in text
    ending = run("identify", "--methods-text", str(tmp_path / "methods.tex"), "--quiet")
    assert ending.status == 0, ending.err
    assert (tmp_path / "methods.bib").read_text().count("@") >= 2
