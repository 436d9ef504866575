"""A report says what its dataset holds, on one page that needs no other."""

import io
import json
import re

import jax
import matplotlib.image
import numpy as np
import pytest
import xarray as xr

from aslo_jax._report import write_report
from aslo_jax.study._bands import bands
from aslo_jax.study._formats import number
from aslo_jax.study._sensitivity import Index
from aslo_jax.study._statistics import Interval, proportion, quantile, rms
from aslo_jax.study._tables import table

SAMPLES = 60
TIME = np.linspace(0.0, 2.0, 21)


@pytest.fixture(scope="module")
def dataset():
    """ASLO is best on the error, Peer settles first; Peer diverges in three samples."""
    rng = np.random.default_rng(0)
    common = np.exp(0.4 * rng.standard_normal(SAMPLES))
    factors = 1e-3 * np.array([1.0, 3.0]) * np.exp(0.1 * rng.standard_normal((SAMPLES, 2)))
    size = common[:, None] * factors
    diverged = np.zeros((SAMPLES, 2), bool)
    diverged[[5, 11, 40], 1] = True
    # Frozen when it diverged: a number that must not count.
    size[5, 1] = 1e-9
    size[11, 1] = np.nan
    error = size[:, None, :] * (1.0 + 9.0 * np.exp(-5.0 * TIME))[:, None]
    settling = common[:, None] * np.array([0.30, 0.20])
    seconds = {"units": "s", "long_name": "settling time"}
    flag = {"units": "1", "long_name": "diverged"}
    webers = {"units": "Wb", "long_name": "rms flux error"}
    ohms = {"units": "ohm", "long_name": "parameter_resistance"}
    return xr.Dataset(
        {
            "rms": (("sample", "observer", "entry"), _entries(size), webers),
            "settling": (("sample", "observer"), settling, seconds),
            "diverged": (("sample", "observer"), diverged, flag),
            "error": (("sample", "time", "observer"), error, {"units": "Wb"}),
            "parameter_resistance": (("sample",), 8.8 + common, ohms),
            "cramer_rao": (("time",), 1e-4 / (0.1 + TIME), {"units": "Wb"}),
            "cramer_rao_rms": ((), 5e-4, {"unknown": 1.2e-3}),
        },
        {"observer": ["ASLO", "Peer <1>"], "time": TIME},
        {
            "seed": 41,
            "steps": 1000,
            "interval": 2e-3,
            "engine": "fused",
            "configuration": json.dumps({"plant": {"resistance": 8.875}}),
            "versions": json.dumps({"aslo_jax": "9.8.7"}),
        },
    )


def _entries(size):
    """Norms as three entries, the third of which only the second observer has."""
    found = np.stack([0.6 * size, 0.8 * size, np.zeros_like(size)], -1)
    found[:, 0, 2] = np.nan
    return found


@pytest.fixture(scope="module")
def written(dataset, tmp_path_factory):
    return write_report(dataset, tmp_path_factory.mktemp("report") / "new")


@pytest.fixture(scope="module")
def page(written):
    return written.read_text()


def row(page, metric, observer):
    """The cells of an observer in the table of a metric."""
    section = page.split(f'<h3 id="{metric}">')[1].split("</table>")[0]
    (line,) = (r for r in section.split("<tr")[1:] if f">{observer}</td>" in r)
    return [re.sub("<[^>]*>", " ", c).split() for c in re.findall("<td.*?</td>", line)]


def test_the_numbers_of_the_tables(dataset, page):
    size = dataset.rms.sel(observer="ASLO").values[:, :2]
    size = np.linalg.norm(size, axis=1)
    cells = row(page, "rms", "ASLO")
    assert cells[:2] == [["1"], ["ASLO"]]
    for cell, found in ((2, quantile(size, 0.5)), (4, quantile(size, 0.95))):
        value, low, high = (number(1e3 * x) for x in found)
        assert cells[cell] == [value, low, "to", high]
    found = rms(size, key=jax.random.key(41))
    assert cells[6][0] == number(1e3 * found.value)
    assert cells[7] == [number(1e3 * size.max()), "sample", str(size.argmax())]
    assert cells[8][0] == number(found.value / 5e-4)
    bound = row(page, "rms", "Cramér-Rao bound")
    assert bound[6] == ["0.500"]


def test_samples_that_diverged_count_as_worst(dataset, page):
    cells = row(page, "rms", "Peer &lt;1&gt;")
    assert cells[0] == ["2"]
    assert cells[5] == cells[6] == ["∞"]
    assert cells[7] == ["∞", "sample", "5"]  # the first of them
    share = proportion(3, SAMPLES)
    ends = [number(100 * share.low), "%", "to", number(100 * share.high), "%"]
    assert cells[9] == ["3", *ends]
    size = np.linalg.norm(dataset.rms.sel(observer="Peer <1>").values, axis=1)
    size[[5, 11, 40]] = np.inf
    assert cells[2][0] == number(1e3 * np.sort(size)[29:31].mean())


def test_the_verdicts(page):
    assert "ASLO is best, with the median" in page
    assert "rms flux error, norm of the entries (10⁻³ Wb)" in page
    assert ">settling time (s)<" in page.replace("\n", "")
    assert "Peer &lt;1&gt; is best, with the median" in page
    ratio = re.search(r"has ([\d.]+) times the value of ASLO in the median sample", page)
    assert ratio and 2.8 < float(ratio[1]) < 3.3
    assert "has 1.50 times the value of Peer &lt;1&gt; in the median sample" in page
    assert "Not finite in 3 of Peer &lt;1&gt;, out of 60 samples each." in page
    assert re.search(r"The rms of ASLO over the samples is [\d.]+ times the Cram", page)
    without = (
        "Without the parameters that are spread in the machine the bound is 2.40 times"
    )
    assert page.count(without) == 1


def test_the_page_stands_alone(page):
    assert not re.search(r"https?:|//[a-z]|<script|<link|@import", page)
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert all(s.startswith(("data:image/svg+xml;base64,", "#")) for s in sources)
    assert sum(s.startswith("data:") for s in sources) == 3
    assert "Peer <1>" not in page  # names are escaped


def test_what_identifies_the_study(page):
    for fact in ("seed: 41", "engine: fused", "samples: 60", "9.8.7", "2 s in 1000 steps"):
        assert fact in page
    assert "&#34;resistance&#34;: 8.875" in page


def test_the_figures_show_something(written):
    for name in ("metrics", "error", "parameters"):
        image = matplotlib.image.imread(
            io.BytesIO((written.parent / f"{name}.png").read_bytes())
        )
        assert image.shape[1] == 1080 and image.shape[0] > 200
        # White but for what is drawn.
        drawn = (image[..., :3] < 0.9).any(-1).mean()
        assert 0.005 < drawn < 0.6
    assert not list(written.parent.glob(".*"))


def test_one_observer_and_no_trajectories(dataset, tmp_path):
    alone = dataset[["settling"]].isel(observer=[1])
    page = write_report(alone, tmp_path, title="Alone").read_text()
    assert "<title>Alone</title>" in page
    assert "Peer &lt;1&gt; has the median 0.2" in page
    assert "Pair by pair" not in page and "bound" not in page
    assert sorted(p.name for p in tmp_path.iterdir()) == ["metrics.png", "report.html"]


def test_entries_over_their_scales(dataset):
    """Entries of different units count by what each is divided by."""
    scaled = dataset.copy()
    scaled["rms"] = scaled["rms"].assign_attrs(scale=[2.0, 4.0, 8.0])
    x = dataset["rms"].sel(observer="ASLO").values
    found = table(scaled, "rms", 0.95)
    expected = np.median(np.hypot(x[:, 0] / 2.0, x[:, 1] / 4.0))
    assert found.summaries["ASLO"].median.value == pytest.approx(expected, rel=1e-12)
    assert found.unit == ""
    assert found.label.endswith("over their scales")


def test_what_decides_the_error(dataset, tmp_path):
    indices = [Index("load_torque", Interval(0.1, 0.0, 0.2), Interval(0.87, 0.8, 0.9))]
    influences = dict.fromkeys(("ASLO", "Peer <1>"), indices)
    page = write_report(dataset, tmp_path, influences=influences).read_text("utf-8")
    row = re.search(r'<td class="text">load torque</td>(.*)</tr>', page)
    assert row is not None
    assert row[1].count("<td>0.870<small>0.800 to 0.900</small></td>") == 2


def test_bands_are_the_quantiles_at_each_instant(dataset, monkeypatch):
    monkeypatch.setattr("aslo_jax.study._bands._BLOCK", 7 * 8 * 2 * TIME.size)
    found = bands(dataset.error)  # in blocks of seven samples, the last of four
    for name in dataset.observer.values:
        x = dataset.error.sel(observer=name).values
        x = np.where(np.isnan(x), np.inf, x)
        np.testing.assert_array_equal(found[name].worst, x.max(0))
        for p, band in zip((0.05, 0.5, 0.95), found[name][:3], strict=True):
            exact = np.quantile(x, p, axis=0, method="inverted_cdf")
            np.testing.assert_allclose(band, exact, rtol=0.006)
    assert np.isinf(found["Peer <1>"].worst).all()
    assert np.isfinite(found["Peer <1>"].high).all()


def test_numbers_in_print():
    values = (0.0, 1234.5, 0.012345, -2.5e-7, 9.999e4, 12345678.0, np.inf, np.nan)
    expected = ["0", "1234", "0.0123", "−2.50×10⁻⁷", "1.00×10⁵", "1.23×10⁷", "∞", "–"]
    assert [number(x) for x in values] == expected


def test_a_dataset_without_metrics_is_refused(dataset, tmp_path):
    with pytest.raises(ValueError, match="`dataset` must hold a metric"):
        write_report(dataset[["error"]], tmp_path / "none")
    assert not (tmp_path / "none").exists()
