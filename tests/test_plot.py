"""Figures show the data they are given, name text as it is, and leave matplotlib alone."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.figure
import numpy as np
import pytest
import xarray as xr
from calibrations import calibrated

import aslo_jax as aslo
from aslo_jax import _text
from aslo_jax.plot import _canvas, _lines
from aslo_jax.study._bands import Band
from aslo_jax.tune import Fitted, Front, History, Surface

T = np.linspace(0.0, 0.5, 51)
TRUTH = np.stack([np.sin(9.0 * T), np.cos(9.0 * T)], axis=1)


def made(factor: float = 1.1) -> aslo.Estimate:
    """Ten per cent too large, coasting for the first five rows."""
    certificate = np.clip(T, 1e-3, None)
    parts = factor * TRUTH, certificate, np.arange(T.size) < 5
    return aslo.Estimate(*map(jnp.asarray, parts))


def dataset(observers=("ASLO", "Peer")) -> xr.Dataset:
    size = np.random.default_rng(2).lognormal(size=(40, 2)) * np.array([1.0, 3.0])
    error = size[:, None, :] * (1.0 + 9.0 * np.exp(-5.0 * T))[:, None]
    return xr.Dataset(
        {
            "rms": (("sample", "observer"), size, {"units": "Wb"}),
            "settling": (("sample", "observer"), 1.0 / size, {"units": "s"}),
            "error": (("sample", "time", "observer"), error, {"units": "Wb"}),
        },
        {"observer": list(observers), "time": T},
    )


def fitted() -> Fitted:
    history = History(
        np.array([4.0, 2.0, 1.0]),
        np.array([[5.0, 50.0], [8.0, 20.0], [10.0, 12.0]]),
        np.array([1.0, 0.1, 0.01]),
        "converged",
    )
    end = history.parameters[-1]
    return Fitted(None, end, 1.0, 4.0, 1.1, 4.1, "converged", [history], 0, "forward")


RATES = np.geomspace(2.0, 100.0, 6)
SURFACE = Surface(RATES, RATES, 1.0 + np.log(RATES[:, None] / RATES) ** 2)
FRONT = Front(
    np.array([0.2, 0.8]),
    np.array([[1.0, 3.0], [2.0, 1.0]]),
    np.array([[1.1, 3.1], [2.1, 1.2]]),
    np.zeros((2, 1)),
)
BANDS = {"ASLO": Band(*(k + np.exp(-T) for k in (1.0, 2.0, 3.0, 4.0)))}


def drawn_calibration(**place):
    units = {"resistance": "Ω", "inductance": "H", "output_offset[0]": "A"}
    return aslo.plot.calibration(calibrated(), units=units, frequency=(38.0, 42.0), **place)


DRAWN = {
    "calibration": drawn_calibration,
    "estimate": lambda **place: aslo.plot.estimate(made(), T, TRUTH, **place),
    "error": lambda **place: aslo.plot.error(made(), T, TRUTH, unit="Wb", **place),
    "bands": lambda **place: aslo.plot.bands(dataset(), **place),
    "ranking": lambda **place: aslo.plot.ranking(dataset(), **place),
    "tuning": lambda **place: aslo.plot.tuning(fitted(), **place),
    "landscape": lambda **place: aslo.plot.landscape(fitted(), SURFACE, **place),
    "front": lambda **place: aslo.plot.front(FRONT, **place),
}
PANELS = dict(
    calibration=5, estimate=2, error=2, bands=2, ranking=2, tuning=3, landscape=1, front=1
)


def lines(figure) -> dict:
    """The data of every line by its name."""
    return {x.get_gid(): x.get_data() for axes in figure.axes for x in axes.get_lines()}


def texts(figure) -> list[str]:
    figure.canvas.draw()
    return [x.get_text() for x in figure.findobj(matplotlib.text.Text) if x.get_text()]


@pytest.mark.parametrize("name", DRAWN)
def test_no_setting_changes_and_pyplot_knows_nothing(name, tmp_path):
    import matplotlib.pyplot as plt

    before, open_figures = dict(matplotlib.rcParams), plt.get_fignums()
    figure = DRAWN[name]()
    assert isinstance(figure, matplotlib.figure.Figure)
    for kind in ("png", "pdf", "svg"):
        figure.savefig(tmp_path / f"figure.{kind}")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before
    assert plt.get_fignums() == open_figures
    # TrueType (42), not outlines (3).
    content = (tmp_path / "figure.pdf").read_bytes()
    assert b"/Type42" in content or b"/CIDFontType2" in content
    assert b"/Type3" not in content


@pytest.mark.parametrize("name", DRAWN)
def test_figures_do_not_depend_on_the_global_style(name):
    expected = DRAWN[name]().bytes("png")
    with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 20.0}):
        assert DRAWN[name]().bytes("png") == expected


@pytest.mark.parametrize("name", DRAWN)
def test_given_axes_and_figures_are_drawn_into(name):
    plain = matplotlib.figure.Figure(figsize=(8, 6))
    axes = plain.subplots(PANELS[name], 1, squeeze=False)[:, 0]
    assert DRAWN[name](axes=axes) is plain
    assert all(panel.get_lines() for panel in axes)
    assert isinstance(plain, matplotlib.figure.Figure)
    plain.savefig("/dev/null", format="png")
    whole = matplotlib.figure.Figure(figsize=(8, 6))
    left, _ = whole.subfigures(1, 2)
    assert DRAWN[name](figure=left) is whole
    assert len(left.axes) >= PANELS[name]
    if PANELS[name] > 1:
        with pytest.raises(ValueError, match=f"`axes` must hold {PANELS[name]} axes"):
            DRAWN[name](axes=axes[:1])
    with pytest.raises(ValueError, match="exclude each other"):
        DRAWN[name](axes=axes, figure=plain)


def test_an_estimate_over_its_truth():
    found = {"A": made(1.1), "B": made(0.9)}
    names = ("flux_alpha", "flux_beta")
    figure = aslo.plot.estimate(found, T, TRUTH, names=names, units="Wb")
    drawn = lines(figure)
    for name, factor in (("A", 1.1), ("B", 0.9)):
        for k, entry in enumerate(names):
            t, x = drawn[f"{name}.{entry}"]
            np.testing.assert_array_equal(t, T)
            np.testing.assert_allclose(x, factor * TRUTH[:, k], rtol=1e-15)
    truths = [x for a in figure.axes for x in a.get_lines() if x.get_label() == "truth"]
    for k, line in enumerate(truths):
        np.testing.assert_array_equal(line.get_ydata(), TRUTH[:, k])
    assert [a.get_ylabel() for a in figure.axes] == ["flux α (Wb)", "flux β (Wb)"]
    shown = texts(figure)
    assert "500 mWb" in shown and "100 ms" in shown


def test_an_error_and_where_it_coasts():
    figure = aslo.plot.error(made(), T, TRUTH, unit="Wb", threshold=1e-2)
    drawn = lines(figure)
    np.testing.assert_allclose(drawn["error"][1], np.full(T.size, 0.1), rtol=1e-12)
    np.testing.assert_array_equal(drawn["error certificate"][1], made().certificate)
    for axes in figure.axes:
        (shade,) = axes.collections
        corners = shade.get_paths()[0].vertices
        assert (corners[:, 0].min(), corners[:, 0].max()) == (0.0, T[5])
        assert axes.get_yscale() == "log"
    low, high = figure.axes[1].get_ylim()
    assert low < 1e-3 and high > 1.0


def test_a_simulation_knows_instants_and_truth():
    motor = aslo.plants.PMSM(
        resistance=1.5, inductance=8e-3, magnet_flux=0.1, pole_pairs=3, inertia=1e-4
    )
    observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(50.0))
    turn = lambda t: 20.0 * jnp.stack([jnp.cos(60.0 * t), jnp.sin(60.0 * t)])
    found = aslo.simulate(
        motor, turn, {"ASLO": observer}, t1=0.1, ts=jnp.linspace(0, 0.1, 21)
    )
    drawn = lines(aslo.plot.error(found, unit="Wb"))
    expected = np.linalg.norm(found.error("ASLO"), axis=1)
    shown = np.isfinite(drawn["ASLO"][1])
    np.testing.assert_allclose(drawn["ASLO"][1][shown], expected[shown], rtol=1e-12)
    assert shown[1:].all()
    with pytest.raises(ValueError, match="must be left out for a `Simulation`"):
        aslo.plot.estimate(found, T)


def test_bands_and_rankings_of_a_study():
    study = dataset()
    drawn = lines(aslo.plot.bands(study))
    size = np.sort(study.rms.sel(observer="Peer").values)
    factor = 1.0 + 9.0 * np.exp(-5.0 * T)
    np.testing.assert_array_equal(drawn["Peer worst"][1], size[-1] * factor)
    np.testing.assert_allclose(drawn["Peer median"][1], size[19] * factor, rtol=0.006)
    top = aslo.plot.bands(study).axes[1].get_ylim()[1]
    assert (
        study["error"].values[:, :, 1].max() < top
    )  # its worst sample is within the frame
    alone = lines(aslo.plot.bands(BANDS, T, bound=np.full(T.size, 0.5)))
    np.testing.assert_array_equal(alone["ASLO median"][1], BANDS["ASLO"].median)
    np.testing.assert_array_equal(alone["bound"][1], 0.5)

    figure = aslo.plot.ranking(study, "settling")
    (axes,) = figure.axes
    # The best at the top: the peer settles first.
    assert [x.get_text() for x in axes.get_yticklabels()] == ["ASLO", "Peer"]
    for name in ("ASLO", "Peer"):
        expected = np.median(study.settling.sel(observer=name))
        assert lines(figure)[f"{name} median"][0] == pytest.approx([expected], rel=1e-12)
    with pytest.raises(ValueError, match="must name metrics of the study, rms, settling"):
        aslo.plot.ranking(study, "peak")
    with pytest.raises(ValueError, match="must hold `error` over time"):
        aslo.plot.bands(study.drop_vars("error"))
    with pytest.raises(ValueError, match=r"`t` must have the shape \(51,\) of the bands"):
        aslo.plot.bands(BANDS, T[1:])


def test_a_descent_a_landscape_and_a_front():
    drawn = lines(aslo.plot.tuning(fitted(), names=("lambda", "gamma")))
    np.testing.assert_array_equal(drawn["loss 0"][1], [4.0, 2.0, 1.0])
    np.testing.assert_array_equal(drawn["parameter 0.1"][1], [50.0, 20.0, 12.0])
    np.testing.assert_array_equal(drawn["gradient 0"][1], [1.0, 0.1, 0.01])
    drawn = lines(aslo.plot.landscape(fitted(), SURFACE, marked={"by hand": (3.0, 4.0)}))
    np.testing.assert_array_equal(drawn["path 0"][0], [5.0, 8.0, 10.0])
    assert (*drawn["tuned"], *drawn["by hand"]) == ([10.0], [12.0], [3.0], [4.0])
    drawn = lines(aslo.plot.front(FRONT))
    np.testing.assert_array_equal(drawn["training"], FRONT.costs.T)
    with pytest.raises(ValueError, match="must hold 2 names, one for each tuned"):
        aslo.plot.tuning(fitted(), names=("lambda",))


def test_a_calibration():
    figure, found = drawn_calibration(), calibrated()
    drawn = lines(figure)
    low, high = drawn["interval inductance"][0]
    np.testing.assert_allclose((low, high), (-20.0, 20.0), rtol=1e-12)
    assert "interval output_offset[0]" not in drawn
    np.testing.assert_allclose(drawn["before resistance"][0], 5.0)
    assert "before output_offset[0]" not in drawn
    x, deviance = drawn["profile resistance"]
    np.testing.assert_allclose(deviance, 4 * (x / 0.2) ** 2, atol=1e-12)
    f, density = drawn["spectrum 0"]
    assert f[np.argmax(density)] == pytest.approx(40.0, abs=2.0)
    # The sum over all frequencies is the variance.
    assert np.sum(density) * (f[1] - f[0]) == pytest.approx(1.01, rel=0.05)
    shown = texts(figure)
    for text in ("from 2 Ω ± 10 mΩ", "from 5 mH ± 1 mH", "from −100 mA, no interval"):
        assert text in shown
    assert {"electrical frequency", "six times it", "not determined"} <= set(shown)
    plain = texts(aslo.plot.calibration(found))
    assert "electrical frequency" not in plain


@pytest.mark.parametrize("name", ["$x$", "$", r"a_b^c$\frac$", "100 % <&>"])
def test_what_a_user_names_is_text(name):
    figures = [
        aslo.plot.estimate({name: made(), "b": made()}, T, names=(name, "other")),
        aslo.plot.bands(dataset((name, "b"))),
        aslo.plot.ranking(dataset((name, "b")).rename(rms=name)),
        aslo.plot.tuning(fitted(), names=(name, "b")),
    ]
    for figure in figures:
        assert any(text in (name, _text.symbol(name)) for text in texts(figure))
        assert not any(
            x.get_parse_math() for x in figure.findobj(matplotlib.text.Text) if x.get_text()
        )
        figure.bytes("svg")
    plain = matplotlib.figure.Figure()
    aslo.plot.estimate(made(), T, names=(name, "other"), axes=plain.subplots(2))
    plain.canvas.draw()


REFUSED = {
    "no instants": (lambda: aslo.plot.estimate(made()), "pass the `t` that `replay` had"),
    "instants": (
        lambda: aslo.plot.estimate(made(), T[1:]),
        r"`t` must have the shape \(51,\), one instant for each row.*has \(50,\)",
    ),
    "truth": (
        lambda: aslo.plot.error(made(), T, TRUTH[:, 0]),
        r"`truth` must have the shape \(51, 2\) of the estimate, but has \(51,\); stack",
    ),
    "no truth": (lambda: aslo.plot.error(made(), T), "`truth` must be given"),
    "names": (
        lambda: aslo.plot.estimate(made(), T, names=("a",)),
        "`names` must hold 2 different names, one for each entry",
    ),
    "units": (
        lambda: aslo.plot.estimate(made(), T, units=("Wb",)),
        "`units` must hold 2 units, one for each entry",
    ),
    "a batch": (
        lambda: aslo.plot.estimate(jax.tree.map(lambda x: x[None], made()), T),
        r"must be one estimate over time.*jax.tree.map\(lambda x: x\[0\]",
    ),
    "an array": (lambda: aslo.plot.estimate(TRUTH, T), "but is of the type ndarray"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=f"(?s){message}"):
        call()


def test_a_long_line_keeps_its_extremes():
    x = np.random.default_rng(0).standard_normal(300_001)
    x[[7, 200_000]], x[50:90] = (60.0, -70.0), np.nan
    t = np.arange(x.size) / 7.0
    kept, shown = _lines.thinned(t, x)
    assert kept.size <= _lines.POINTS + 2 and (np.diff(kept) > 0).all()
    assert (kept[0], kept[-1]) == (t[0], t[-1])
    np.testing.assert_array_equal(shown, x[np.searchsorted(t, kept)])
    assert (np.nanmax(shown), np.nanmin(shown)) == (60.0, -70.0)
    assert _lines.thinned(t[:100], x[:100])[1] is not None


def test_labels_stay_inside_and_apart():
    """Everything that is drawn lies in the figure, and no label of an axis on another."""
    for draw in DRAWN.values():
        figure = draw()
        figure.canvas.draw()
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                low, high = sorted(axis.get_view_interval())
                boxes = [axis.label.get_window_extent()] if axis.label.get_text() else []
                boxes += [
                    x.get_window_extent()
                    for x, at in zip(
                        axis.get_ticklabels(), axis.get_ticklocs(), strict=False
                    )
                    if x.get_text() and x.get_visible() and low <= at <= high
                ]
                for k, box in enumerate(boxes):
                    assert figure.bbox.padded(1).containsx(box.x0), axis
                    assert figure.bbox.padded(1).containsx(box.x1), axis
                    assert not any(box.overlaps(other) for other in boxes[k + 1 :]), axis


def test_names_and_numbers_in_print():
    names = ("u_alpha", "omega_electrical", "qdot1", "u2", "position", "_", "$x$")
    expected = ("u α", "ω electrical", "q̇₁", "u₂", "position", "_", "$x$")
    assert tuple(map(_text.symbol, names)) == expected
    marks = [_text.mark(x) for x in (0.0, 0.25, -3.0, 1e-4, 3e-7, -1e6)]
    assert marks == ["0", "0.25", "−3", "10⁻⁴", "3×10⁻⁷", "−10⁶"]
    assert _canvas.shortened("a" * 50, 11) == "aaaaa…aaaaa"


def test_it_is_lazy_and_names_its_extra():
    code = """
import sys, aslo_jax as aslo
print(aslo.plot.__all__, "matplotlib" in sys.modules)
sys.modules["matplotlib"] = None
try:
    aslo.plot.front
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines() == [
        f"{aslo.plot.__all__} False",
        'the package `matplotlib` is not installed: pip install "aslo_jax[plot]"',
    ], done.stderr
