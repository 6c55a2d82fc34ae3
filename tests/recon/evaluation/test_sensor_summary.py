"""Figures of a sensor from readings whose noise is known."""

import time

import numpy as np
import pytest
from uncle.recon.evaluation.noise_curves import BetaSamples
from uncle.recon.evaluation.sensor_summary import (
    DEFAULT_PARAMETERS,
    SensorWeightSummary,
    sensor_weight_summary,
    summarise_sensor,
)
from uncle.recon.evaluation.uncertainty_calibration import evaluate_uncertainty
from uncle.recon.visualization.uncertainty_table import summary_table


def readings(depth: np.ndarray, scale: float = 0.01) -> BetaSamples:
    """Beta is `scale` times depth squared."""
    nothing = np.full(len(depth), np.nan)
    return BetaSamples(depth, nothing, scale * depth**2, nothing)


def test_betas_are_those_of_readings_at_that_distance():
    found = summarise_sensor(readings(np.linspace(0.5, 4.0, 20_000)), SensorWeightSummary(0.4, 0.2))
    for metres in (1, 2, 3):
        assert found.beta_at_m[str(metres)] == pytest.approx(0.01 * metres**2, rel=0.01)
    assert found.beta_at_m["5"] is None
    assert found.median_beta_m == pytest.approx(0.01 * 2.25**2, rel=0.01)
    assert (found.low_beta_m, found.high_beta_m) == pytest.approx((0.01 * 0.85**2, 0.01 * 3.65**2), rel=0.02)
    assert (found.weight_share, found.reliability, found.measurements) == (0.4, 0.2, 20_000)


def test_a_distance_needs_readings():
    fewest = DEFAULT_PARAMETERS.min_measurements
    for count, known in ((fewest - 1, False), (fewest, True)):
        depth = np.concatenate([np.full(1000, 3.0), np.full(count, 1.0)])
        assert (summarise_sensor(readings(depth)).beta_at_m["1"] is not None) == known


def test_table_puts_sensors_side_by_side():
    depth = np.linspace(0.5, 4.0, 5000)
    scores = evaluate_uncertainty(0.01 * depth**2, 0.01 * depth**2)
    sensors = {
        "sl": summarise_sensor(readings(depth), SensorWeightSummary(0.75, 1.2345), scores),
        "sgm": summarise_sensor(readings(depth, 0.05)),
    }
    header, rows = summary_table(sensors)
    assert header == ["Metric", "sl", "sgm", "Unit"]
    assert all(len(row) == len(header) for row in rows)
    table = {row[0]: row[1:] for row in rows}
    assert table["weight share"] == ["75.0", "-", "%"]
    assert table["sensor reliability"] == ["1.23", "-", ""]
    assert "sensor reliability" not in {row[0] for row in summary_table({"sgm": sensors["sgm"]})[1]}
    assert table["beta at 2 m"] == ["4.00", "20.00", "cm"]
    assert table["beta at 5 m"] == ["-", "-", "cm"]
    assert table["coverage of the 90 % interval"] == ["100.00", "-", "%"]


def test_what_sensors_count_comes_from_the_map_stage(make_box_run):
    run = make_box_run(angles=np.zeros(1))
    assert sensor_weight_summary(run, "sl") == SensorWeightSummary()
    for recorded, known in (({"sl": 0.75}, 0.75), ({"sl": 1}, 1.0), ({"sl": "much"}, None), ({}, None), ([1], None)):
        run.finish_stage("map", "0", time.time(), {"sensor_weight_share": recorded})
        assert sensor_weight_summary(run, "sl") == SensorWeightSummary(weight_share=known)
        run.finish_stage("map", "0", time.time(), {"sensor_weight_share": {"sl": 0.5}, "sensor_reliability": recorded})
        assert sensor_weight_summary(run, "sl") == SensorWeightSummary(0.5, known)
