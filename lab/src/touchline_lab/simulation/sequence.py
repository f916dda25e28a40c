"""What a recording says of itself: the content of sequence.yaml."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from touchline_lab.simulation.robot.sensors import SENSOR_PERIOD_S, ImuNoise
from touchline_lab.simulation.scenario import Scenario
from touchline_lab.simulation.stage import events_of_light
from touchline_lab.simulation.world.calibration_layout import Layout

if TYPE_CHECKING:
    from touchline_lab.simulation.cameras.factory import SimulatedCamera

JPEG_QUALITY = 92


def describe(
    scenario: Scenario, events: Iterable[Mapping[str, Any]], layout: Layout, camera: SimulatedCamera
) -> dict[str, Any]:
    """sequence.yaml of a run, in the usual order; `simulation` is all that is needed to make it again."""
    happened = [dict(event) for event in events if float(event["t"]) <= scenario.seconds]
    happened += events_of_light(scenario.light)
    wheels = scenario.sensors.wheels
    return {
        "format": 1,
        "name": scenario.name,
        "field": scenario.field,
        "camera": scenario.camera.kind,
        "rate_hz": scenario.camera.rate_hz,
        "description": scenario.description,
        "events": sorted(happened, key=lambda event: float(event["t"])),
        "imu": _imu(scenario.sensors.imu),
        "wheels": {"a_dir_rad": wheels.a_dir_rad, "b_dir_rad": wheels.b_dir_rad},
        "sensor": {**camera.sensor.sequence_constants(), "jpeg_quality": JPEG_QUALITY, "chroma": "4:2:0"},
        **layout.sequence,
        "simulation": scenario.model_dump(mode="json"),
    }


def _imu(noise: ImuNoise) -> dict[str, Any]:
    low, high = noise.gyro_bias_deg_s
    return {
        "rate_hz": round(1.0 / SENSOR_PERIOD_S),
        "gyro_bias_magnitude_deg_s": f"{low:g} to {high:g}, unknown sign, plus a random walk",
        "gyro_bias_walk_deg_s_per_sqrt_s": noise.gyro_bias_walk_deg_s,
        "gyro_noise_deg_s": noise.gyro_noise_deg_s,
        "compass_drift_deg_rms": noise.compass_drift_deg,
        "compass_drift_time_constant_s": noise.compass_drift_time_s,
        "compass_field_disturbance_deg_rms": noise.compass_place_deg,
        "compass_noise_deg": noise.compass_noise_deg,
        "tilt_noise_deg": noise.tilt_noise_deg,
        "tilt_bias_deg": f"below {noise.tilt_bias_deg:g}, constant",
        "tilt_and_yaw_lag_s": noise.tilt_and_yaw_lag_s,
    }
