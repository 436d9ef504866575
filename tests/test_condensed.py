"""What rates are chosen by: a log in blocks, however its rows come."""

import numpy as np
import pytest

from aslo_jax.logs import Log
from aslo_jax.machines import PMSMDescription
from aslo_jax.machines._condensed import BLOCK, Condensing, blocks
from aslo_jax.machines._noise import white_noise

OF_Y, OF_U = 0.013, 0.21


def motor():
    machine = {
        "kind": "pmsm",
        "resistance": 1.7,
        "inductance": 6e-3,
        "magnet_flux": 0.11,
        "pole_pairs": 3,
        "inertia": 1e-3,
    }
    return PMSMDescription.model_validate({"machine": machine})


def noisy(rows, seed=5):
    t = 1e-4 * np.arange(rows)
    angle = 90.0 * t + 20.0 * np.sin(0.5 * t)
    turned = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    random = np.random.default_rng(seed)
    u = 11.0 * turned + OF_U * random.standard_normal((rows, 2))
    return Log(t, u, 4.0 * turned[:, ::-1] + OF_Y * random.standard_normal((rows, 2)), {})


@pytest.mark.parametrize("rows", [1, BLOCK - 1, BLOCK + 3, 2 * BLOCK, 3 * BLOCK + 17])
def test_blocks_cover_every_row_once_and_none_is_short_but_the_only_one(rows):
    found = blocks(rows)
    assert np.array_equal(np.concatenate([np.arange(rows)[k] for k in found]), range(rows))
    assert len(found) == 1 or min(k.stop - k.start for k in found) >= BLOCK


@pytest.mark.parametrize("batch", [7_001, 50_000, 123_457])
def test_batches_of_any_length_are_condensed_to_the_same_bits(batch):
    log, machine = noisy(3 * BLOCK + 1_234), motor()
    log.y[[5, 70_000, 149_999]] = np.nan
    condensing = Condensing(machine.condensed)
    for k in range(0, log.t.size, batch):
        rows = slice(k, k + batch)
        condensing.add(Log(log.t[rows], log.u[rows], log.y[rows], {}))
    found = condensing.result(log.t)
    kept = np.isfinite(log.y).all(axis=1)
    assert np.array_equal(found.t, log.t[kept])
    assert np.array_equal(found.u, (log.u - 1.7 * log.y)[kept])
    at_once = machine.rates(log)
    assert machine.rates_of(found) == at_once
    assert {"cutoff", "forgetting", "pll_bandwidth"} <= at_once.keys()


@pytest.mark.parametrize("rows", [BLOCK + 3, 2 * BLOCK + 3])
def test_a_few_rows_left_over_do_not_count_as_a_record_without_noise(rows):
    log = noisy(rows)
    condensing = Condensing(motor().condensed)
    condensing.add(log)
    found = condensing.result(log.t).noise
    whole = white_noise(log.u, log.y, [(0, 1)], [(0, 1)])
    assert found.output == pytest.approx(whole.output, rel=0.02)
    assert found.output == pytest.approx([OF_Y] * 2, rel=0.03)
    assert found.input == pytest.approx([OF_U] * 2, rel=0.03)
