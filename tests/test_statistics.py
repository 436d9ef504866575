"""The intervals hold the truth as often as they say, and what diverged counts as worst."""

import jax
import numpy as np
import pytest
import scipy.stats

from aslo_jax.study._comparison import compare, holm, ranking
from aslo_jax.study._statistics import mean, proportion, quantile, rms, summarise


def holds(intervals, truth):
    return np.mean([low <= truth <= high for _, low, high in intervals])


# Of 400 intervals at 95 % the share that holds has the deviation 1.1 %.
@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95])
def test_a_quantile_s_interval_holds_for_a_skew_distribution(probability):
    rng = np.random.default_rng(1)
    truth = scipy.stats.lognorm(1.5).ppf(probability)
    draws = np.exp(1.5 * rng.standard_normal((400, 200)))
    share = holds([quantile(x, probability) for x in draws], truth)
    # The number of samples below is whole, so the coverage is rounded up.
    assert 0.94 < share < 0.99


def test_a_quantile_and_its_interval_agree_with_scipy():
    x = np.random.default_rng(2).exponential(size=333)
    for probability in (0.05, 0.31, 0.9):
        found = quantile(x, probability, 0.9)
        reference = scipy.stats.quantile_test(x, p=probability)
        assert found[1:] == tuple(reference.confidence_interval(0.9))
        expected = np.quantile(x, probability, method="averaged_inverted_cdf")
        assert found.value == expected
    assert quantile(x[:100], 0.5).value == np.median(x[:100])
    # Eight samples say nothing of how large the largest can be.
    assert quantile(x[:8], 0.95).high == np.inf
    assert quantile(x[:8], 0.05).low == -np.inf


@pytest.mark.parametrize("samples", [60, 501])
def test_the_intervals_of_the_mean_and_of_the_rms_hold(samples):
    """501 samples are resampled in batches, of two and three. Of 100 intervals at 95 % the
    share that holds has the deviation 2.2 %."""
    rng = np.random.default_rng(3)
    draws = rng.gamma(4.0, 0.5, (100, samples))
    assert 0.88 < holds([mean(x) for x in draws], 2.0) <= 0.99
    assert 0.88 < holds([rms(x) for x in draws], np.sqrt(5.0)) <= 0.99


def test_batches_change_neither_the_mean_nor_the_width_of_its_interval():
    x = np.random.default_rng(4).gamma(2.0, 1.0, 12_345)
    value, low, high = mean(x, 0.9)
    np.testing.assert_allclose(value, x.mean(), rtol=1e-15)
    width = 2.0 * 1.645 * x.std() / np.sqrt(x.size)
    # The spread of 200 batches is known to 5 %: three deviations.
    np.testing.assert_allclose(high - low, width, rtol=0.15)
    assert mean(x, 0.9) == (value, low, high)
    assert mean(x, 0.9, key=jax.random.key(1)) != (value, low, high)


def test_a_constant_and_a_single_sample():
    assert mean(np.full(30, 0.1)) == pytest.approx((0.1, 0.1, 0.1), rel=1e-15)
    assert rms(np.zeros(3)) == (0.0, 0.0, 0.0)
    assert mean(np.array([2.0])) == (2.0, -np.inf, np.inf)
    assert rms(np.array([3.0])) == (3.0, 0.0, np.inf)


def test_the_rms_of_large_numbers_does_not_overflow():
    value, low, high = rms(np.array([3e200, 4e200, 3e200, 4e200]))
    np.testing.assert_allclose(value, np.sqrt(12.5) * 1e200)
    assert 3e200 <= low < value < high <= 4e200


def test_a_proportion_has_the_exact_interval():
    value, low, high = proportion(0, 1_000)
    assert (value, low) == (0.0, 0.0)
    np.testing.assert_allclose(high, 1.0 - 0.025**0.001, rtol=1e-9)


def test_what_diverged_is_worst_and_counted():
    x = np.array([3.0, np.nan, 1.0, 2.0, np.inf, 4.0, 5.0])
    found = summarise(x)
    assert (found.samples, found.failures) == (7, 2)
    assert found.failing == proportion(2, 7)
    assert found.median.value == 4.0  # of 1, 2, 3, 4, 5, inf, inf
    assert found.high.value == found.worst == np.inf
    assert found.mean == found.rms == (np.inf,) * 3
    assert np.isnan(x[1])  # the caller's array is left alone
    # All seven lie below a quantile with chance quantile^7.
    np.testing.assert_allclose(found.below**7, 0.05)
    assert quantile(np.array([1.0, np.inf]), 0.5).value == 1.0


def test_a_known_ratio_is_found():
    rng = np.random.default_rng(5)
    a = np.exp(rng.standard_normal(300))
    values = {"A": a, "B": 1.25 * a * np.exp(0.3 * rng.standard_normal(300))}
    (found,) = compare(values)
    assert found.better == "A" and found.p < 1e-10
    assert found.ratio.low < 0.8 < found.ratio.high
    share = scipy.stats.norm.cdf(np.log(1.25) / 0.3)
    assert found.wins.low < share < found.wins.high and found.ties == 0.0
    # A test that forgets the pairs sees nothing in the spread of the samples.
    assert scipy.stats.mannwhitneyu(a, values["B"]).pvalue > 0.01
    second = ranking(values)[1]
    assert (second.rank, second.observer) == (2, "B")
    np.testing.assert_allclose(second.ratio[0] * found.ratio.value, 1.0)
    np.testing.assert_allclose(second.ratio[1] * found.ratio.high, 1.0)


def test_equals_are_told_apart_as_rarely_as_promised():
    rng = np.random.default_rng(6)
    false = 0
    for _ in range(60):
        common = rng.standard_normal(40)
        values = {n: np.exp(common + 0.5 * rng.standard_normal(40)) for n in "ABC"}
        false += any(c.better for c in compare(values))
    assert false <= 8  # at most 5 % of 60, and three deviations
    same = ranking({"A": np.ones(9), "B": np.ones(9), "C": np.ones(9)})
    assert [place.rank for place in same] == [1, 1, 1]


def test_the_p_of_a_pair_is_scipy_s():
    rng = np.random.default_rng(7)
    a, b = rng.exponential(size=(2, 30))
    (found,) = compare({"A": a, "B": b})
    expected = scipy.stats.wilcoxon(np.log(a / b)).pvalue
    np.testing.assert_allclose(found.p, expected, rtol=1e-12)


def test_a_zero_does_not_outweigh_the_rest():
    """A settles at once in six of 40 samples, and else takes three times as long."""
    b = np.linspace(0.1, 0.2, 40)
    a = np.where(np.arange(40) < 6, 0.0, 3.0 * b)
    (found,) = compare({"A": a, "B": b})
    assert found.better == "B" and found.p < 1e-4
    assert found.wins.value == 0.15
    np.testing.assert_allclose(found.ratio, 3.0)


def test_diverging_loses_and_ties_are_ties():
    good = np.linspace(1.0, 2.0, 40)
    bad = np.where(np.arange(40) < 30, np.nan, good)
    (found,) = compare({"bad": bad, "good": good})
    assert found.better == "good" and found.ratio.value == np.inf
    assert found.ties == 0.25 and found.wins.value == 0.0
    worst = ranking({"bad": bad, "good": good})[1]
    assert worst.observer == "bad" and worst.median.value == np.inf
    both = np.full(20, np.inf)
    (found,) = compare({"A": both, "B": both})
    assert (found.p, found.ties, found.ratio.value) == (1.0, 1.0, 1.0)


def test_holm_s_correction():
    found = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    np.testing.assert_allclose(found, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.9, 0.8])), 1.0)


def test_arguments_that_make_no_sense():
    with pytest.raises(ValueError, match="`confidence` must be between 0 and 1"):
        mean(np.ones(3), 95.0)
    with pytest.raises(ValueError, match="`probability` must be between 0 and 1"):
        quantile(np.ones(3), 1.0)
    with pytest.raises(ValueError, match="`x` must hold at least one sample"):
        summarise(np.ones(0))
    with pytest.raises(ValueError, match="as many samples for every observer"):
        compare({"A": np.ones(3), "B": np.ones(4)})
    with pytest.raises(ValueError, match=r"must not be negative.*'B' is -1"):
        compare({"A": np.ones(3), "B": -np.ones(3)})
