"""Steps of exported C: what may change between them, and what they refuse."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import Compiled, columns, error, rows_of
from exported_motor import (
    export_motor,
    motor_estimate,
    motor_log,
    motor_observer,
    of_motor,
    ran,
)

import aslo_jax as aslo


def test_intervals_that_vary_substeps_and_missing_samples(tmp_path):
    log = motor_log()
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(2000, 700, replace=False))
    t, u, y = log.t[rows], log.u[rows], log.y[rows].copy()
    y[200:203] = np.nan
    made = export_motor(interval=None, substeps=2, missing="coast")
    observer = motor_observer()
    replayed = aslo.replay(observer, t, u, y, substeps=2, missing="coast")
    found = Compiled(made, tmp_path)(rows_of(u, y, np.diff(t)))
    assert error(found, columns(of_motor(replayed))) < 1e-12
    names = [f.name for f in made.inputs]
    assert names == ["dt", "u", "y"]


def test_what_is_refused_changes_nothing(tmp_path):
    log = motor_log()
    made = export_motor(interval=None)
    code = Compiled(made, tmp_path)
    rows = rows_of(log.u, log.y, np.diff(log.t))[:50]
    good = code(rows)
    bad = {1: (3, np.nan), 3: (0, 0.0)}
    for status, (column, value) in bad.items():
        broken = rows.copy()
        broken[20, column] = value
        got, out = code.status(broken)
        assert got == status
        np.testing.assert_array_equal(out[:20], good[:20])
        assert not out[20:].any()
    main = """
        #include <string.h>
        #include "motor.h"
        int main(void) {
            static motor_state state, before;
            motor_parameters with; motor_output out; double u[2] = {0, 0}, y[2] = {0, 0};
            motor_defaults(&with);
            if (motor_step(&state, &with, 2e-4, u, y, &out) != MOTOR_NOT_BEGUN) return 1;
            if (motor_init(&state, &with, y, &out) != MOTOR_OK) return 2;
            before = state;
            y[1] = 1e308; y[1] *= 10.0;
            if (motor_step(&state, &with, 2e-4, u, y, &out) != MOTOR_NOT_FINITE) return 3;
            return memcmp(&state, &before, sizeof state) ? 4 : 0;
        }"""
    assert ran(tmp_path, main, "motor.c") == 0


def test_two_instances_and_two_observers_in_one_binary(tmp_path):
    """Side by side, turn by turn: each is as it is alone."""
    export_motor().write(tmp_path)
    export_motor(prefix="other", fixed=("all",), dtype="float32").write(tmp_path)
    main = """
        #include "motor.h"
        #include "other.h"
        int main(void) {
            motor_state a, b, alone; motor_output x, y, z; motor_parameters p, q;
            other_state c; other_output w;
            int k;
            double u[2], i[2]; float v[2], j[2];
            motor_defaults(&p); q = p; q.first_filter_rate = 60.0;
            for (k = 0; k < 200; ++k) {
                u[0] = 3.0 - 0.01 * k; u[1] = 0.02 * k;
                i[0] = 0.5 * u[1]; i[1] = 1.0 - i[0];
                v[0] = (float)u[0]; v[1] = (float)u[1];
                j[0] = (float)i[0]; j[1] = (float)i[1];
                if (k == 0) {
                    motor_init(&a, &p, i, &x); motor_init(&b, &q, i, &y);
                    motor_init(&alone, &p, i, &z); other_init(&c, j, &w);
                } else {
                    motor_step(&alone, &p, u, i, &z);
                    motor_step(&b, &q, u, i, &y);
                    other_step(&c, v, j, &w);
                    motor_step(&a, &p, u, i, &x);
                }
            }
            if (x.flux[0] != z.flux[0] || x.speed != z.speed) return 1;
            if (x.certificate == y.certificate) return 2;
            return (w.flux[0] - x.flux[0] < 1e-3 && x.flux[0] - w.flux[0] < 1e-3) ? 0 : 3;
        }"""
    assert ran(tmp_path, main, "motor.c", "other.c") == 0


def test_parameters_are_tuned_at_run_time(tmp_path):
    log = motor_log()
    made = export_motor()
    names = [f.name for f in made.parameters]
    values = [float(f.default) for f in made.parameters]
    changes = {
        "first_filter_rate": 90.0,
        "first_relation_resistance": 9.1,
        "second_bandwidth": 60.0,
    }
    for name, value in changes.items():
        values[names.index(name)] = value
    where = lambda o: (o.first.filter.rate, o.first.relation.resistance, o.second.bandwidth)
    other = eqx.tree_at(where, motor_observer(), tuple(map(jnp.asarray, changes.values())))
    expected = columns(of_motor(aslo.replay(other, log.t, log.u, log.y)))
    found = Compiled(made, tmp_path)(rows_of(log.u, log.y), values)
    assert error(found, expected) < 1e-12


def test_fixed_parameters_are_computed_beforehand(tmp_path):
    log = motor_log()
    expected = motor_estimate()
    free, fixed = export_motor(), export_motor(fixed=("all",))
    assert fixed.parameters == ()
    assert fixed.operations < 0.6 * free.operations
    assert fixed.of_parameters == 0
    assert error(Compiled(fixed, tmp_path)(rows_of(log.u, log.y)), expected) < 1e-12
    with pytest.raises(ValueError, match=r"`fixed` must hold .*first_filter_rate.*'rate'"):
        export_motor(fixed=("rate",))
