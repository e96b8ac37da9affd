"""Compare a track without GPS to the GPS of the same log: rms after one turn and one shift in the plane.

    python benchmarks/accuracy/against_gps.py ../shared/data/logs/derived_mcap/test1_ros2_zstd.mcap

The track must come from odometry and IMU alone; its heading is relative, so one turn is fitted. A scale fitted on top
shows what a wheel calibration would still give.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from attest_cli.estimate import estimate
from attest_cli.locate import locate
from attest_cli.pipeline import read
from attest_cli.segment import find_segments
from attest_cli.settings import load_settings

SEMI_MAJOR_M, ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3  # WGS-84


def level(fixes: np.ndarray) -> np.ndarray:
    """East and north (m, 2) of geodetic fixes (m, 3), rad and m, about the first: WGS-84 radii of curvature."""
    latitude, longitude, _ = fixes.T
    w2 = 1.0 - ECCENTRICITY_2 * np.sin(latitude[0]) ** 2
    normal, meridian = SEMI_MAJOR_M / np.sqrt(w2), SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2) / w2**1.5
    return np.stack(
        [(longitude - longitude[0]) * normal * np.cos(latitude[0]), (latitude - latitude[0]) * meridian], axis=1
    )


def main() -> None:
    """Smooth the log in memory and print the misfit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--absolute", default="auto", choices=("auto", "always", "stops"))
    wanted = parser.parse_args()
    settings = load_settings(None, wanted.log, {"smoothing.absolute": wanted.absolute}).settings
    _, log = read([wanted.log], settings)
    segmentation = find_segments(log, settings)
    found = estimate(log, segmentation, settings)
    place, vehicle, _ = locate(log, segmentation, found, settings)
    gps = log.fixes["gps"]
    truth = level(gps.values)
    track = np.stack([np.interp(gps.t, found.smoothed.t, place.p[:, i]) for i in range(2)], axis=1)
    a, b = track - track.mean(axis=0), truth - truth.mean(axis=0)
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = a @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    scale = np.sum(turned * b) / np.sum(a * a)
    rms = np.sqrt(np.mean(np.sum((turned - b) ** 2, axis=1)))
    scaled = np.sqrt(np.mean(np.sum((scale * turned - b) ** 2, axis=1)))
    print(f"{wanted.log.name}: {place.method}, {sum(place.distance.values()):.0f} m driven, {vehicle.told['how']}")
    print(f"rms {rms:.2f} m after one turn and shift; {scaled:.2f} m with a scale of {scale:.4f}")


if __name__ == "__main__":
    main()
