"""The faults: every row of the matrix of what goes wrong with logs, each on a drive that shows it."""

from __future__ import annotations

import numpy as np
from journeys.odd_logs import ACCEL, GYRO, ODOMETRY, Drive
from support.changes import (
    MAG,
    SUN,
    G,
    Q,
    S,
    added,
    averaged,
    blind,
    bursts,
    chain,
    clipped,
    clocks,
    comma,
    conjugated,
    covariances,
    cut,
    dead,
    during,
    field_turned,
    frozen,
    gravity_removed,
    hard_iron,
    in_motion,
    in_turn,
    integers,
    jitter,
    late,
    lines,
    magnetic,
    midway,
    outliers,
    put,
    renamed,
    repeated,
    rounded,
    rows,
    scaled,
    second,
    shuffled,
    soft_iron,
    spikes,
    stale,
    stamps,
    steady,
    sun_field,
    sun_turned,
    swapped,
    turned,
    two_imus,
    unmounted,
    without,
    xyzw,
    zero_header,
    zero_quaternion,
)
from support.faults import Fault, messages, text

GPS = ("latitude", "longitude", "altitude")
NO_HEADING = ("no-heading",)


STAMPS: dict[str, Fault] = {
    "duplicate rows": Fault("sun", ("duplicate-rows",), repeated),
    "batches of 4 share a stamp": Fault("sun", ("batched-stamps",), bursts(4)),
    "some equal stamps": Fault("sun", ("batched-stamps",), bursts(2)),
    "rows swapped": Fault("sun", ("rows-out-of-order",), shuffled),
    "stamps step back 0.2 s": Fault(
        "sun", ("rows-out-of-order", "steps back", "clock-slipped"), stamps(lambda t, ns: ns - (t > 40) * S // 5)
    ),
    "stamps step back 5 s": Fault("sun", ("steps back",), stamps(lambda t, ns: ns - (t > 40) * 5 * S)),
    "u32 wrap of ms": Fault("bare", ("steps back", "wrap"), write=text(integers(10**6, 2**32 - 40000, "t_ms", 2**32))),
    "u32 wrap of us": Fault(
        "bare", ("steps back", "wrap"), write=text(integers(10**3, 2**32 - 40_000_000, "t_us", 2**32))
    ),
    "clock steps 6 years ahead": Fault("sun", ("imu-gap",), stamps(lambda t, ns: ns + (t > 40) * 189_000_000 * S),
                                       same_truth=False),
    "gap of 2 s": Fault("sun", ("imu-gap",), rows(lambda d: (d.t < 30) | (d.t > 32))),
    "gap of 20 s": Fault("sun", ("imu-gap",), rows(lambda d: (d.t < 20) | (d.t > 40))),
    "gap of 1000 s": Fault("sun", ("imu-gap",), stamps(lambda t, ns: ns + (t > 40) * 1000 * S), same_truth=False),
    "time in s": Fault("sun", (), write=text(second(1.0, name="t"))),
    "time in ms, no unit": Fault("sun", ("time-unit-guessed",), write=text(integers(10**6, 0, "t"))),
    "time in us, no unit": Fault("sun", ("time-unit-guessed",), write=text(integers(10**3, 0, "t"))),
    "time in ns, no unit": Fault("sun", ("time-unit-guessed",), write=text(integers(1, 0, "t"))),
    "float32 stamps since 1970": Fault(
        "sun", ("distinct stamps", "resolution"),
        stamps(lambda _, ns: np.float32(ns * 1e-9).astype(np.float64) * 1e9)),
    "stamps as %.6g": Fault("bare", ("distinct stamps", "resolution"), write=text(
        second(1.0, form="{:.6g}", start=1.78e9, name="t"))),
    "stamps in 10 ms steps at 50 Hz": Fault("sun", (), write=text(second(1.0, form="{:.2f}", name="t"))),
    "stamps in 0.1 s steps": Fault("sun", ("batched-stamps",), write=text(second(1.0, form="{:.1f}", name="t"))),
    "zero header stamps": Fault("bare", ("zero-header-stamps",), write=messages(zero_header), base=NO_HEADING),
    "sun on another clock, no overlap": Fault(
        "sun", ("clock-offset", "no-overlap"), write=messages(clocks(10_000 * S, "sun"))),
    "jitter of 3 ms": Fault("sun", (), jitter(0.003)),
    "jitter of 1 ms at 10 Hz": Fault("sun", (), chain(averaged(5), jitter(0.001)), same_truth=False),
    "IMU at 10 Hz": Fault("bare", (), averaged(5), base=NO_HEADING, same_truth=False),
    "four of five rows left out": Fault(
        "bare", ("gyro-noise-refuted",), rows(lambda d: np.arange(len(d.t)) % 5 == 0), base=NO_HEADING),
    "every fifth row lost": Fault("bare", (), rows(lambda d: np.arange(len(d.t)) % 5 != 2)),
    "every fifth row lost, hand": Fault("hand", ("imu-rows-missing",), rows(lambda d: np.arange(len(d.t)) % 5 != 2)),
    "30 % of the rows lost": Fault(
        "bare", (), rows(lambda d: np.random.default_rng(1).random(len(d.t)) > 0.3),
        base=(*NO_HEADING, "imu-rows-missing", "stop-advice"), needless=True),
    "negative stamps": Fault("sun", (), stamps(lambda _, ns: ns - 2 * ns[0])),
    "zero stamps in some rows": Fault(
        "bare", ("steps back", "zero"), stamps(lambda t, ns: np.where((t > 30) & (t < 31), 0, ns))),
    "one row from the future": Fault(
        "bare", ("rows-without-time",), stamps(lambda t, ns: ns + (np.arange(len(t)) == 1500) * 400 * S)),
    "time runs ten times too slow": Fault(
        "bare", ("clock-rate", "time-scale", "gyro-scale"),
        stamps(lambda _, ns: ns[0] + (ns - ns[0]) // 10)),
}  # fmt: skip

LATE: dict[str, Fault] = {
    "sun 10 s late": Fault("sun always", ("sun-late", "rejected-sun", "innovations-sun"), late(10.0, *SUN)),
    "sun 0.3 s late": Fault("sun always", ("sun-late",), late(0.3, *SUN)),
    "magnetometer 1 s late": Fault("magnetometer", (), late(1.0, *MAG)),
    "magnetometer 0.2 s late in a hand": Fault("hand", (), late(0.2, *MAG)),
    "compass 5 s late": Fault("compass", ("compass-late", "innovations-compass", "rejected-compass"),
                              late(5.0, "compass_deg")),
    "orientation 0.5 s late": Fault("orientation", ("orientation-late",), late(0.5, *Q)),
    "orientation 5 s late": Fault(
        "orientation", ("orientation-late", "innovations-orientation", "rejected-orientation"), late(5.0, *Q)),
    "odometry 0.5 s late": Fault("odometry", ("odometry-late",), late(0.5, *ODOMETRY)),
    "odometry 5 s late": Fault("odometry", ("odometry-late", "stop-margin"), late(5.0, *ODOMETRY)),
    "GPS 1 s late": Fault("gps", (), late(1.0, *GPS, "gps_sigma_m")),
}  # fmt: skip

VALUES: dict[str, Fault] = {
    "NaN cells": Fault(
        "sun", ("imu-not-finite",), lambda d: put(d, ("gyro_y",), np.arange(len(d.t)) % 37 == 5, np.nan)),
    "inf cells": Fault(
        "sun", ("imu-not-finite",), lambda d: put(d, ("accel_x",), np.arange(len(d.t)) % 300 == 5, np.inf)),
    "NaN for 3 s": Fault("sun", ("imu-not-finite", "imu-gap"), during(30.0, 33.0, GYRO, np.nan)),
    "NaN column": Fault("sun", ("gyro_z",), during(-1.0, 1e9, ("gyro_z",), np.nan)),
    "zero column": Fault("sun", ("imu-stuck",), during(-1.0, 1e9, ("gyro_z",), 0.0)),
    "gyro all zero": Fault("sun", ("imu-stuck",), during(-1.0, 1e9, GYRO, 0.0)),
    "accelerometer constant": Fault(
        "sun", ("imu-stuck",), chain(during(-1, 1e9, ACCEL[:2], 0.1), during(-1, 1e9, ACCEL[2:], 9.8))),
    "gyro axis stuck 0.5 s": Fault("sun", ("imu-stuck",), frozen(30.0, 30.5, "gyro_z")),
    "gyro axis stuck 5 s": Fault("sun", ("imu-stuck",), frozen(30.0, 35.0, "gyro_z")),
    "gyro axis stuck 30 s": Fault("sun", ("imu-stuck",), frozen(20.0, 50.0, "gyro_z")),
    "gyro axis stuck to the end": Fault("sun", ("imu-stuck",), frozen(40.0, 1e9, "gyro_x")),
    "accelerometer axis stuck 5 s": Fault("sun", ("imu-stuck",), frozen(30.0, 35.0, "accel_x")),
    "accelerometer axis stuck at a stop": Fault("sun", ("imu-stuck",), frozen(2.0, 7.0, "accel_x")),
    "IMU frozen 0.5 s": Fault("sun", ("imu-stuck",), frozen(30.0, 30.5, *GYRO, *ACCEL)),
    "IMU frozen 10 s": Fault("sun", ("imu-stuck",), frozen(20.0, 30.0, *GYRO, *ACCEL)),
    "IMU frozen 10 s, no heading": Fault("bare", ("imu-stuck",), frozen(20.0, 30.0, *GYRO, *ACCEL)),
    "gyro axis dead but for its noise": Fault("bare", ("imu-stuck",), dead("gyro_z")),
    "gyro axis dead but for its noise, compass": Fault("compass", ("imu-stuck",), dead("gyro_x")),
    "gyro axis dead but for its noise, walk": Fault("walk", ("gyro-noise-raised",), dead("gyro_z", 0.005)),
    "gyro holds its values, twice": Fault("sun", ("imu-held",), stale(2, *GYRO)),
    "gyro holds its values, five times, hand": Fault("hand", ("imu-held",), stale(5, *GYRO)),
    "gyro drops to zero for 3 s": Fault("bare", ("imu-stuck",), during(30.0, 33.0, GYRO, 0.0)),
    "gyro saturates": Fault(
        "hand", ("gyro-clipped",), clipped(1.8, *GYRO)),
    "accelerometer saturates": Fault("walk", (), clipped(11.0, *ACCEL)),
    "one spike": Fault("sun", ("imu-spikes",), spikes(1, 400.0, "accel_z")),
    "forty gyro spikes": Fault("sun", ("imu-spikes",), spikes(40, 30.0, "gyro_z")),
    "small gyro spikes": Fault("bare", ("imu-spikes", "gyro-noise-raised"), spikes(20, 3.0, "gyro_z")),
    "spikes of 3 samples": Fault("bare", ("imu-spikes", "gyro-noise-raised", "separation"),
                                 spikes(15, 8.0, "gyro_z", width=3)),
    "compass drifts": Fault("compass", ("lasting-compass",), lambda d: d.changed(
        compass_deg=(d.columns["compass_deg"] + 0.1 * d.t) % 360.0)),
    "values of 1e300": Fault("sun", ("imu-spikes", "imu-not-finite", "not finite"), spikes(3, 1e300, "gyro_x")),
    "float32 values": Fault("sun", (), lambda d: d.changed(
        **{n: d.columns[n].astype(np.float32).astype(np.float64) for n in (*GYRO, *ACCEL)})),
    "gyro rounded to 0.01 rad/s": Fault("bare", ("gyro-coarse",), rounded(0.01, *GYRO), base=NO_HEADING),
    "counts of 16 bits as floats": Fault("sun", (), chain(rounded(1 / 938.7, *GYRO), rounded(G / 2048, *ACCEL))),
    "raw counts": Fault("bare", ("counts", "unit"), chain(scaled(938.7, *GYRO), scaled(2048 / G, *ACCEL))),
}  # fmt: skip

UNITS: dict[str, Fault] = {
    "gyro in deg/s": Fault("bare", ("unit-contradicted", "deg/s"), scaled(57.29578, *GYRO)),
    "gyro z in deg/s": Fault("odometry", ("unit-contradicted",), scaled(57.29578, "gyro_z")),
    "gyro x in deg/s, walk": Fault("walk", ("unit-contradicted",), scaled(57.29578, "gyro_x")),
    "gyro y in rad/s, taken for deg/s": Fault("gps", ("unit-contradicted",), scaled(1 / 57.29578, "gyro_y")),
    "gyro in deg/s on the level": Fault("level", ("unit-doubted",), scaled(57.29578, *GYRO)),
    "gyro in deg/s, sun": Fault("sun", ("unit-contradicted", "deg/s"), scaled(57.29578, *GYRO)),
    "gyro in deg/s from the middle on": Fault("bare", ("unit changes",), midway(57.29578, *GYRO)),
    "gyro in deg/s from the middle on, walk": Fault("walk", ("unit changes",), midway(57.29578, *GYRO)),
    "gyro in deg/s from the middle on, level": Fault("level", ("unit changes",), midway(57.29578, *GYRO)),
    "gyro in deg/s from the middle on, hand": Fault("hand", ("unit changes",), midway(57.29578, *GYRO)),
    "gyro in deg/s up to the middle, walk": Fault(
        "walk", ("unit changes",), chain(scaled(57.29578, *GYRO), midway(0.01745329, *GYRO))),
    "gyro in deg/s, header says nothing": Fault(
        "bare", ("unit-guessed",), scaled(57.29578, *GYRO), text(lambda c: c.replace("gyro_", "g", 3))),
    "gyro stated deg/s, is rad/s": Fault(
        "bare", ("unit-contradicted",), write=text(lambda c: c.replace('gyro_x"', 'gyro_x [deg/s]"', 1).replace(
            'gyro_y"', 'gyro_y [deg/s]"', 1).replace('gyro_z"', 'gyro_z [deg/s]"', 1))),
    "accelerometer in g": Fault("bare", ("unit-contradicted",), scaled(1 / G, *ACCEL)),
    "accelerometer in mg": Fault("bare", ("unit-contradicted",), scaled(1e3 / G, *ACCEL)),
    "both in g and deg/s": Fault(
        "bare", ("unit-contradicted", "deg/s"), chain(scaled(1 / G, *ACCEL), scaled(57.29578, *GYRO))),
    "magnetometer in gauss": Fault("magnetometer", ("unit-contradicted",), scaled(0.01, *MAG)),
    "magnetometer in mG": Fault("magnetometer", ("unit-contradicted",), scaled(10.0, *MAG)),
    "magnetometer in T": Fault("magnetometer", ("unit-contradicted",), scaled(1e-6, *MAG)),
    "magnetometer normalised": Fault("magnetometer", ("magnetometer-normalised",), scaled(1 / 47.86, *MAG)),
    "gravity removed": Fault("bare", ("no gravity",), gravity_removed()),
    "gravity removed, sun": Fault("sun", ("no gravity",), gravity_removed()),
    "accelerometer scale 10 %": Fault("sun", ("accel-scale",), scaled(1.1, *ACCEL)),
    "gyro scale 5 %": Fault("sun", ("gyro-noise-raised", "gyro-scale", "separation"), scaled(1.05, *GYRO)),
    "gyro scale 5 %, no heading": Fault(
        "bare", ("gyro-noise-raised", "gyro-scale", "separation"), scaled(1.05, *GYRO)),
    "gyro scale 2 %": Fault("sun", (), scaled(1.02, *GYRO)),
    "gyro scale -2 %, compass": Fault("compass", (), scaled(0.98, *GYRO)),
    "gyro scale 3 %, no heading": Fault("bare", (), scaled(1.03, *GYRO)),
    "gyro x scale 10 %": Fault("sun", ("gyro-scale",), scaled(1.1, "gyro_x")),
    "gyro y scale -5 %, compass": Fault("compass", ("gyro-scale",), scaled(0.95, "gyro_y")),
    "gyro z scale 10 %, odometry": Fault("odometry", ("gyro-scale",), scaled(1.1, "gyro_z")),
    "gyro scale 1 %, no heading": Fault("bare", (), scaled(1.01, *GYRO)),
    "gyro scale -1 %, odometry": Fault("odometry", (), scaled(0.99, *GYRO)),
    "gyro scale 1 %, magnetometer": Fault("magnetometer", (), scaled(1.01, *GYRO)),
    "gyro scale -1 %, gps": Fault("gps", (), scaled(0.99, *GYRO)),
    "gyro scale 1 %, walk": Fault("walk", (), scaled(1.01, *GYRO)),
    "gyro z scale 5 %, hand": Fault("hand", ("gyro-scale",),
                                    scaled(1.05, *GYRO)),
    "accelerometer x in g": Fault("bare", ("accel-scale",), scaled(1 / G, "accel_x")),
    "accelerometer y in g, sun": Fault("sun", ("accel-scale",), scaled(1 / G, "accel_y")),
    "accelerometer bias of 0.5 m/s^2": Fault("bare", ("accel-bias",), added(0.5, "accel_x")),
    "accelerometer bias of 0.5 m/s^2, sun": Fault("sun", ("accel-bias",), added(0.5, "accel_x")),
    "accelerometer bias of 0.3 m/s^2, walk": Fault("walk", ("accel-bias",), added(0.3, "accel_x")),
    "gyro bias of 3 deg/s": Fault("sun", (), added(0.05, *GYRO)),
    "gyro bias of 10 deg/s": Fault("sun", ("gyro-bias",), added(0.17, *GYRO)),
    "gyro bias jumps 0.5 deg/s amid the drive": Fault(
        "bare", ("stop-bias", "separation", "rejected-zero_rate"), added(0.009, *GYRO, after=25.0)),
    "gyro bias drifts": Fault(
        "bare", ("gyro-noise-raised", "separation", "gyro-bias", "stop-bias"),
        lambda d: d.changed(**{n: d.columns[n] + 0.01 * d.t / 90 for n in GYRO})),
    "gyro noise ten times": Fault("sun", ("gyro-noise-refuted",), lambda d: d.changed(
        **{n: d.columns[n] + np.random.default_rng(k).normal(0, 0.01, len(d.t)) for k, n in enumerate(GYRO)})),
}  # fmt: skip

AXES: dict[str, Fault] = {
    "accelerometer reversed": Fault("sun", ("mounting-contradicted",), scaled(-1.0, *ACCEL)),
    "accelerometer reversed, bare": Fault("bare", ("mounting-contradicted",), scaled(-1.0, *ACCEL)),
    "gyro reversed": Fault("bare", ("gyro-against-accel",), scaled(-1.0, *GYRO)),
    "gyro x reversed": Fault("bare", ("gyro-against-accel",), scaled(-1.0, "gyro_x")),
    "gyro z reversed": Fault("bare", ("gyro-against-accel",), scaled(-1.0, "gyro_z")),
    "gyro z reversed, sun": Fault("sun", ("gyro-against-accel", "gyro"), scaled(-1.0, "gyro_z")),
    "gyro z reversed, compass": Fault("compass", ("gyro-against-accel", "gyro"), scaled(-1.0, "gyro_z")),
    "gyro z reversed, hand": Fault("hand", ("gyro-against-accel",), scaled(-1.0, "gyro_z")),
    "gyro z reversed, walk": Fault(
        "walk", ("gyro-against-accel", "gyro-noise-raised", "rejected-gravity"), scaled(-1.0, "gyro_z")),
    "gyro z reversed, GPS": Fault("gps", ("gyro-against-accel", "gps"), scaled(-1.0, "gyro_z")),
    "gyro x and y swapped": Fault("bare", ("gyro-against-accel",), swapped("gyro_x", "gyro_y")),
    "gyro x and z swapped": Fault("bare", ("gyro-against-accel",), swapped("gyro_x", "gyro_z")),
    "accelerometer x and y swapped": Fault("bare", ("gyro-against-accel",), swapped("accel_x", "accel_y")),
    "accelerometer x reversed": Fault("bare", ("gyro-against-accel",), scaled(-1.0, "accel_x")),
    "accelerometer x reversed, sun": Fault("sun", ("gyro-against-accel",), scaled(-1.0, "accel_x")),
    "gyro and accelerometer x and y swapped": Fault(
        "sun", ("rejected-sun", "innovations-sun", "gyro-against-accel"), chain(
            swapped("gyro_x", "gyro_y"), swapped("accel_x", "accel_y"))),
    "both z, y, x (left-handed), bare": Fault(
        "bare", ("gyro-against-accel",), chain(swapped("gyro_x", "gyro_z"), swapped("accel_x", "accel_z"))),
    "IMU on its side, mounting stated upright": Fault("sun", ("mounting-contradicted",), turned(90, 0, 0)),
    "IMU on its side, mounting auto": Fault(
        "odometry", (), chain(turned(90, 0, 0), unmounted), base=NO_HEADING, needless=False),
    "IMU turned 90 deg in yaw, compass": Fault(
        "compass", ("odometry-contradicts",), turned(0, 0, 90)),
    "sun sensor 20 deg askew": Fault("sun", ("rejected-sun", "rejected-gravity"), lambda d: sun_turned(d, 20.0)),
}  # fmt: skip


SUNS: dict[str, Fault] = {
    "sun outliers 1 %": Fault("sun always", ("rejected-sun", "sun-not-unit"), outliers(0.01, *SUN)),
    "sun outliers 20 %": Fault("sun always", ("rejected-sun", "sun-not-unit"), outliers(0.2, *SUN)),
    "sun stale": Fault("sun always", ("stale-repeats",), stale(8, *SUN)),
    "sun repeats twice": Fault("sun always", (), stale(2, *SUN)),
    "sun zero vectors": Fault("sun", ("sun-dropped",), lambda d: put(d, SUN, np.arange(len(d.t)) % 100 == 0, 0.0)),
    "sun not unit": Fault("sun", ("sun-not-unit", "rejected-sun", "innovations-sun"), scaled(0.8, *SUN)),
    "sun x a tenth short": Fault(
        "sun", ("lasting-sun", "rejected-sun", "innovations-sun"), scaled(0.9, "sun_x")),
    "sun x a tenth short, always": Fault(
        "sun always", ("lasting-sun", "rejected-sun", "innovations-sun"), scaled(0.9, "sun_x")),
    "sun in millivolt": Fault("sun", ("sun-not-unit",), scaled(1000.0, *SUN)),
    "sun reference tilted 30 deg": Fault("sun", ("rejected-sun", "innovations-sun"), sun_field(30.0)),
    "sun reference below the horizon": Fault("sun", ("sun-not-used", "rejected-sun"), sun_field(-60.0)),
    "sun x and y swapped": Fault("sun", ("rejected-sun", "innovations-sun"), swapped("sun_x", "sun_y")),
    "sun lost after 30 s": Fault("sun always", (), during(30.0, 1e9, SUN, np.nan)),
    "sun column blank": Fault("sun", ("channel-empty",), during(-1.0, 1e9, SUN, np.nan)),
    "compass outliers 20 %": Fault("compass", ("rejected-compass",), outliers(0.2, "compass_deg", size=150.0)),
    "compass outliers 1 %": Fault("compass", ("rejected-compass",), outliers(0.01, "compass_deg", size=150.0)),
    "compass in rad": Fault("compass", ("rejected-compass",), scaled(0.0174533, "compass_deg")),
    "compass counter-clockwise": Fault(
        "compass", ("rejected-compass",), scaled(-1.0, "compass_deg")),
    "compass magnetic, 15 deg": Fault("sun and compass", ("rejected-compass", "rejected-sun"), magnetic(15.0)),
    "compass 8 deg off, GPS": Fault("compass and gps", (), magnetic(8.0)),
    "compass 12 deg off, GPS": Fault("compass and gps", ("compass-offset",), magnetic(-12.0)),
    "compass 8 deg off, vehicle": Fault("vehicle", ("compass-offset",), magnetic(8.0)),
    "compass 20 deg off, vehicle": Fault("vehicle", ("compass-offset", "heading-contradicted"), magnetic(-20.0)),
    "compass 8 deg off, GPS hardly shows it": Fault("compass and gps, no wheels", (), magnetic(-8.0)),
    "compass 20 deg off, GPS hardly shows it": Fault(
        "compass and gps, no wheels", ("compass-offset",), magnetic(20.0)),
    "field of a place with 15 deg more declination": Fault("magnetometer and gps", (), field_turned(15.0)),
    "field of a place with 30 deg more declination": Fault(
        "magnetometer and gps", ("magnetometer-offset", "heading-contradicted"), field_turned(30.0)),
    "compass stuck": Fault("compass", ("stale-repeats",), during(-1, 1e9, ("compass_deg",), 77.0)),
    "compass from east": Fault("compass", ("rejected-compass",), lambda d: d.changed(
        compass_deg=np.mod(90.0 - d.columns["compass_deg"], 360.0))),
    "magnetometer outliers 20 %": Fault(
        "magnetometer", (), outliers(0.2, *MAG, size=60.0)),
    "hard iron 20 %": Fault("magnetometer", ("magnetometer-uncalibrated",), hard_iron(0.2)),
    "hard iron 50 %": Fault("magnetometer", ("magnetometer-uncalibrated",), hard_iron(0.5)),
    "magnetometer turned in a hand": Fault("hand", ("gyro-against-field",), swapped("mag_x", "mag_y")),
    "hard iron 50 %, hand": Fault("hand", ("magnetometer-uncalibrated",), hard_iron(0.5)),
    "soft iron": Fault("magnetometer", ("magnetometer-uncalibrated",), soft_iron),
    "soft iron, hand": Fault("hand", (), soft_iron),
    "magnetometer NaN in half the rows": Fault("magnetometer", (), lambda d: put(
        d, MAG, np.arange(len(d.t)) // 5 % 2 == 0, np.nan)),
    "magnetometer frozen": Fault("magnetometer", ("stale-repeats",), frozen(0.0, 1e9, *MAG)),
    "magnetometer zero": Fault("magnetometer", ("magnetometer-dropped",), during(-1, 1e9, MAG, 0.0)),
    "magnetometer z reversed": Fault("magnetometer", ("magnetometer-uncalibrated",), scaled(-1.0, "mag_z")),
    "magnetometer x and y swapped": Fault(
        "magnetometer", ("rejected-magnetometer", "magnetometer-uncalibrated"), swapped("mag_x", "mag_y")),
}  # fmt: skip

ORIENTATIONS: dict[str, Fault] = {
    "orientation outliers 1 %": Fault("orientation", ("rejected-orientation",), outliers(0.01, *Q)),
    "orientation outliers 20 %": Fault("orientation", ("rejected-orientation",), outliers(0.2, *Q)),
    "orientation zero": Fault("orientation", ("orientation-dropped",), lambda d: put(
        d, Q, np.arange(len(d.t)) % 50 == 0, 0.0)),
    "orientation x, y, z, w": Fault("orientation", ("orientation-order",), xyzw),
    "orientation world to body": Fault("orientation", ("orientation-order",), conjugated),
    "orientation stale": Fault("orientation", ("stale-repeats",), stale(10, *Q)),
    "orientation not unit": Fault("orientation", (), scaled(1.7, *Q)),
    "orientation identity": Fault("orientation", ("stale-repeats", "rejected-orientation"), chain(
        during(-1, 1e9, Q[:1], 1.0), during(-1, 1e9, Q[1:], 0.0))),
    "zero quaternions beside the IMU": Fault("sun", (), write=messages(zero_quaternion)),
}  # fmt: skip

PLACES: dict[str, Fault] = {
    "GPS outliers 1 fix": Fault("gps", ("gps-outliers", "rejected-gps", "innovations-gps"),
                                outliers(0.01, "latitude", size=0.01)),
    "GPS outliers 20 %": Fault("gps", ("gps-outliers", "gps-scatters", "rejected-gps", "innovations-gps"),
                               outliers(0.2, "latitude", "longitude", size=0.001)),
    "GPS 0, 0": Fault("gps", ("gps-dropped",), during(-1.0, 12.0, GPS[:2], 0.0)),
    "GPS latitude and longitude swapped": Fault("gps", ("gps-elsewhere",), swapped("latitude", "longitude")),
    "GPS in 1e-7 deg": Fault("gps", ("unit-contradicted",), scaled(1e7, "latitude", "longitude")),
    "GPS in rad": Fault("gps", ("unit-contradicted",), scaled(np.pi / 180, "latitude", "longitude")),
    "GPS stale": Fault("gps", ("stale-repeats",), stale(6, *GPS)),
    "GPS blank": Fault("gps", ("gps-dropped", "channel-empty"), during(-1.0, 1e9, GPS, np.nan)),
    "GPS with three digits": Fault("gps", ("gps-coarse",), rounded(1e-3, "latitude", "longitude")),
    "tracker leaps half a metre and stays there": Fault(
        "tracker", ("position-jump",), added(0.5, "position_x", after=45.0)),
    "GPS leaps 40 m and stays there": Fault("vehicle", ("gps-jump",), added(4e-4, "latitude", after=60.0)),
    "GPS sigma of 1 mm": Fault("gps", (), lambda d: d.changed(
        gps_sigma_m=0.001 * d.columns["gps_sigma_m"])),
    "odometry reversed": Fault("odometry", ("odometry-contradicts",), scaled(-1.0, *ODOMETRY)),
    "odometry scale 2": Fault("odometry", ("odometry-contradicts",), scaled(2.0, *ODOMETRY)),
    "odometry in km/h": Fault("odometry", ("odometry-contradicts",), scaled(3.6, *ODOMETRY)),
    "odometry zero": Fault("odometry", ("odometry-contradicts",), during(-1.0, 1e9, ODOMETRY, 0.0)),
    "odometry sideways": Fault("odometry", ("odometry-sideways",), swapped("velocity_x", "velocity_y")),
    "odometry stuck": Fault("odometry", ("stop-margin", "odometry-contradicts"), frozen(30.0, 1e9, *ODOMETRY)),
    "odometry ends early": Fault("odometry", ("odometry-silent",), during(40.0, 1e9, ODOMETRY, np.nan)),
    "odometry outliers 5 %": Fault("odometry", (), outliers(0.05, "velocity_x", size=20.0)),
    "temperature garbage": Fault("sun", (), lambda d: d.changed(
        temperature_c=np.where(np.arange(len(d.t)) % 7 == 0, 1e9, np.nan))),
}  # fmt: skip

SHAPES: dict[str, Fault] = {
    "no absolute sensor": Fault("bare", ("no-heading",)),
    "no stop": Fault("bare", ("no-stop",), in_motion,
        same_truth=False),
    "too short": Fault("bare", ("at least",), lambda d: d.span(0.0, 1.0)),
    "one row": Fault("bare", ("at least",), lambda d: d.rows(np.arange(1))),
    "one row, CSV": Fault("bare", ("at least",), lambda d: d.rows(np.arange(1)), text()),
    "empty": Fault("bare", ("empty",), write=text(lambda _: "")),
    "header only": Fault("bare", ("no row", "no rows"), write=text(lambda c: c.splitlines()[0] + "\n")),
    "no rows in Parquet": Fault("bare", ("no row", "empty", "no rows"), lambda d: d.rows(np.arange(0))),
    "no motion": Fault("bare", (), steady, base=NO_HEADING, same_truth=False),
    "two IMUs": Fault("bare", ("several-channels",), two_imus),
    "rows of two IMUs in turn": Fault("bare", ("two IMUs in turn",), in_turn(2)),
    "bad covariances": Fault("sun", (), write=messages(covariances(1.797e308))),
    "negative covariances": Fault("sun", (), write=messages(covariances(-3.0))),
    "NaN covariances": Fault("sun", (), write=messages(covariances(float("nan")))),
}  # fmt: skip


TEXTS: dict[str, Fault] = {
    "cut amid a line": Fault("bare", (), lambda d: d, text(cut(0.7)), base=(*NO_HEADING, "ragged-rows")),
    "BOM": Fault("bare", (), write=text(lambda c: "\ufeff" + c), base=NO_HEADING),
    "CRLF": Fault("bare", (), write=text(lambda c: c.replace("\n", "\r\n")), base=NO_HEADING),
    "semicolons and decimal commas": Fault("bare", (), write=text(comma), base=NO_HEADING),
    "quotes": Fault("bare", (), write=text(lines(lambda ls: [
        ls[0], *(",".join(f'"{c}"' for c in line.split(",")) for line in ls[1:])])), base=NO_HEADING),
    "comments": Fault("bare", (), write=text(lines(lambda ls: [
        "# a log", ls[0], *ls[1:50], "# half-way", *ls[50:]])), base=NO_HEADING),
    "missing column": Fault("bare", ("gyro_z",), without("gyro_z"), text()),
    "missing time": Fault("bare", ("no time column",), write=text(renamed("timestamp_ns", "spare"))),
    "column twice": Fault("bare", ("more than once",), write=text(renamed("gyro_z", "gyro_y"))),
    "text in a cell": Fault("bare", ("text-cells",), write=text(lines(lambda ls: [
        *ls[:100], ls[100].replace(ls[100].split(",")[2], "oops"), *ls[101:]]))),
    "ragged rows": Fault("bare", ("ragged-rows",), write=text(lines(lambda ls: [*ls[:90], ls[90] + ",1,2", *ls[91:]]))),
    "columns z, y, x": Fault("bare", (), lambda d: Drive(
        {n: d.columns[n] for n in ("timestamp_ns", *GYRO[::-1], *ACCEL[::-1])}, d.truth, d.config), text(),
        base=NO_HEADING),
    "header repeated amid the rows": Fault("bare", ("text-cells", "rows-without-time"), write=text(lines(
        lambda ls: [*ls[:900], ls[0], *ls[900:]]))),
    "units row": Fault("bare", (), write=text(lines(lambda ls: [
        ls[0], "ns,rad/s,rad/s,rad/s,m/s^2,m/s^2,m/s^2", *ls[1:]])), base=NO_HEADING),
}  # fmt: skip

CLEAN: dict[str, Fault] = {
    f"clean {kind}": Fault(kind, base=base, needless=True)
    for kind, base in {
        "sun": (), "sun always": (), "compass": (), "magnetometer": (), "orientation": (),
        "gps": ("north-not-shown", "no-heading"),
        "sun and compass": (), "compass and gps": (), "compass and gps, no wheels": (), "magnetometer and gps": (),
        "vehicle": (), "tracker": (), "odometry": NO_HEADING, "bare": NO_HEADING,
        "level": NO_HEADING, "walk": NO_HEADING, "hand": (),
    }.items()
}  # fmt: skip
CLEAN["clean bare, noise not stated"] = Fault("bare", (), blind, base=NO_HEADING, needless=True)

FAULTS: dict[str, Fault] = {
    **STAMPS, **LATE, **VALUES, **UNITS, **AXES, **SUNS, **ORIENTATIONS, **PLACES, **SHAPES, **TEXTS, **CLEAN
}  # fmt: skip
"""Name -> fault."""
