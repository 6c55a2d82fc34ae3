"""Figures of a sensor from readings whose noise is known."""

import time

import numpy as np
import pytest
from uncle.recon.calibration import evaluate_uncertainty
from uncle.recon.noise_curves import Readings
from uncle.recon.uncertainty_summary import FEWEST, map_shares, summarise, summary_table


def readings(depth: np.ndarray, scale: float = 0.01) -> Readings:
    """Beta is `scale` times depth squared."""
    nothing = np.full(len(depth), np.nan)
    return Readings(depth, nothing, scale * depth**2, nothing)


def test_betas_are_those_of_readings_at_that_distance():
    found = summarise(readings(np.linspace(0.5, 4.0, 20_000)), 0.4)
    for metres in (1, 2, 3):
        assert found.beta_at_m[str(metres)] == pytest.approx(0.01 * metres**2, rel=0.01)
    assert found.beta_at_m["5"] is None
    assert found.median_beta_m == pytest.approx(0.01 * 2.25**2, rel=0.01)
    assert (found.low_beta_m, found.high_beta_m) == pytest.approx((0.01 * 0.85**2, 0.01 * 3.65**2), rel=0.02)
    assert (found.map_share, found.readings) == (0.4, 20_000)


def test_a_distance_needs_readings():
    for count, known in ((FEWEST - 1, False), (FEWEST, True)):
        depth = np.concatenate([np.full(1000, 3.0), np.full(count, 1.0)])
        assert (summarise(readings(depth), None).beta_at_m["1"] is not None) == known


def test_table_puts_sensors_side_by_side():
    depth = np.linspace(0.5, 4.0, 5000)
    scores = evaluate_uncertainty(0.01 * depth**2, 0.01 * depth**2)
    sensors = {"sl": summarise(readings(depth), 0.75, scores), "sgm": summarise(readings(depth, 0.05), None)}
    header, rows = summary_table(sensors)
    assert header == ["Figure", "sl", "sgm", "Unit"]
    assert all(len(row) == len(header) for row in rows)
    table = {row[0]: row[1:] for row in rows}
    assert table["share in the map"] == ["75.0", "-", "%"]
    assert table["beta at 2 m"] == ["4.00", "20.00", "cm"]
    assert table["beta at 5 m"] == ["-", "-", "cm"]
    assert table["coverage of the 90 % interval"] == ["100.00", "-", "%"]


def test_shares_come_from_the_map_stage(make_box_run):
    run = make_box_run(angles=np.zeros(1))
    assert map_shares(run) == {}
    for recorded, known in (
        ({"sl": 0.75, "sgm": 0.25}, {"sl": 0.75, "sgm": 0.25}), ({"sl": "much", "sgm": 1}, {"sgm": 1.0}), ([1], {}),
        (None, {}),
    ):  # fmt: skip
        run.finish_stage("map", "0", time.time(), {"sensor_share": recorded})
        assert map_shares(run) == known
