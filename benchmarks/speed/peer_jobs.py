"""One peer on one log, in a process of its own: prints its CPU seconds and what it found as JSON.

    python benchmarks/speed/peer_jobs.py NAME LOG

A reader makes arrays of all messages. A filter gets gyro, accelerometer and magnetometer as arrays, at the times of the
IMU; only its own work counts, not the imports and not the reading. The error of its inclination against the truth
beside the log shows that it was used as it should be.
"""

from __future__ import annotations

import json
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81
NODE, FIELD = 20, 4
"""IMU samples from one update with gravity or one node of gtsam to the next, 10 Hz at 200 Hz; with the field, 50 Hz."""
GYRO_DENSITY, BIAS_WALK, TILT_SIGMA, FIELD_SIGMA = 1.5e-4, 5e-6, 0.05, 0.02
FIRST_STOP_S = 5.0
COVARIANCES = ("orientation", "angular_velocity", "linear_acceleration", "magnetic_field")


@dataclass(frozen=True)
class Drive:
    """A log as arrays: ``gyro`` rad/s, ``accel`` m/s^2 and ``mag`` tesla (n, 3) at ``dt`` s, ``field_n`` (3,)."""

    t: Array
    gyro: Array
    accel: Array
    mag: Array
    dt: float
    field_n: Array


def drive(log: Path) -> Drive:
    """Read a simulated log."""
    readers, settings = import_module("attest_cli.readers"), import_module("attest_cli.settings")
    channels = {channel.role: channel for channel in readers.read(log, settings.Settings()).channels}
    imu, magnetometer = channels["imu"], channels["magnetometer"]
    start = imu.stamps_ns[0]
    t, t_mag = (imu.stamps_ns - start) * 1e-9, (magnetometer.stamps_ns - start) * 1e-9
    gyro, accel = (np.stack([imu.values[f"{name}_{axis}"] for axis in "xyz"], axis=1) for name in ("gyro", "accel"))
    mag = np.stack([np.interp(t, t_mag, magnetometer.values[f"mag_{axis}"]) for axis in "xyz"], axis=1)
    field = tomllib.loads(log.with_name("attest.toml").read_text("utf-8"))["world"]["magnetic_field_ut"]
    return Drive(t, gyro, accel, mag, float(t[-1] / (len(t) - 1)), 1e-6 * np.array(field))


def ups(q: Array) -> Array:
    """Return the vertical in body axes (n, 3) of attitudes body to world (n, 4), wxyz."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z], axis=1)


def vqf(log: Drive) -> Callable[[], Array]:
    """Offline VQF, 9D: no covariance."""
    offline = import_module("vqf").offlineVQF
    arrays = [np.ascontiguousarray(a) for a in (log.gyro, log.accel, log.mag)]
    return lambda: ups(offline(*arrays, log.dt)["quat9D"])


def imufusion(log: Drive) -> Callable[[], Array]:
    """imufusion, a causal complementary filter called sample by sample."""
    module = import_module("imufusion")

    def work() -> Array:
        ahrs = module.Ahrs()
        settings = module.AhrsSettings()
        settings.sample_rate = 1.0 / log.dt
        ahrs.set_settings(settings)
        found = np.empty((len(log.t), 4))
        turns, forces, fields = np.degrees(log.gyro), log.accel / GRAVITY, log.mag * 1e6
        for k in range(len(found)):
            ahrs.update(turns[k], forces[k], fields[k])
            found[k] = ahrs.get_quaternion()
        return ups(found)

    return work


def ahrs(log: Drive) -> Callable[[], Array]:
    """EKF of ahrs: causal; north-east-down, body axes forward-right-down, gravity instead of specific force."""
    ekf = import_module("ahrs.filters").EKF
    turned = np.array([1.0, -1.0, -1.0])
    gyro, gravity, mag = log.gyro * turned, -log.accel * turned, log.mag * turned * 1e9
    reference = np.array([log.field_n[1], log.field_n[0], -log.field_n[2]]) * 1e9

    def work() -> Array:
        found = ekf(gyr=gyro, acc=gravity, mag=mag, frequency=1.0 / log.dt, frame="NED", magnetic_ref=reference)
        return -ups(found.Q) * turned

    return work


def filterpy(log: Drive) -> Callable[[], Array]:
    """Kalman filter and RTS smoother of filterpy: errors of attitude and bias about an integrated gyro, 6 states."""
    kalman = import_module("filterpy.kalman").KalmanFilter
    turned = import_module("scipy.spatial.transform").Rotation.from_rotvec

    def work() -> Array:
        n, filter_ = len(log.t), kalman(dim_x=6, dim_z=3)
        filter_.P = np.diag([0.02] * 3 + [1e-4] * 3) ** 2
        filter_.R = np.eye(3) * (GRAVITY * TILT_SIGMA) ** 2
        filter_.Q = np.diag([GYRO_DENSITY**2 * log.dt] * 3 + [BIAS_WALK**2 * log.dt] * 3)
        up = np.array([0.0, 0.0, GRAVITY])
        tilted, headed = (np.hstack([np.cross(np.eye(3), v), np.zeros((3, 3))]) for v in (up, log.field_n))
        R_field = np.eye(3) * FIELD_SIGMA**2 * (log.field_n @ log.field_n)
        still = int(FIRST_STOP_S / log.dt)
        steps = turned((log.gyro - log.gyro[:still].mean(axis=0)) * log.dt).as_matrix()
        R, nominal = levelled(log.accel[:still].mean(axis=0)), np.empty((n, 3, 3))
        states, covariances, transitions = np.empty((n, 6, 1)), np.empty((n, 6, 6)), np.tile(np.eye(6), (n, 1, 1))
        for k in range(n):
            transitions[k, :3, 3:] = -R * log.dt
            nominal[k] = R
            filter_.predict(F=transitions[k])
            if k % NODE == 0:
                filter_.update((R @ log.accel[k] - up)[:, None], H=tilted)
            if k % FIELD == 0:
                filter_.update((R @ log.mag[k] - log.field_n)[:, None], R_field, headed)
            states[k], covariances[k] = filter_.x, filter_.P
            R = R @ steps[k]
        x = filter_.rts_smoother(states, covariances, Fs=transitions, Qs=[filter_.Q] * n)[0]
        return np.asarray(np.einsum("nji,nj->ni", nominal, turned(-x[:, :3, 0]).as_matrix()[:, :, 2]))

    return work


def simdkalman(log: Drive) -> Callable[[], Array]:
    """Kalman filter and smoother of simdkalman, whose matrices are the same at all times: six states as filterpy's, but
    of a bias that stays in the world.
    """
    lib = import_module("simdkalman")
    turned = import_module("scipy.spatial.transform").Rotation.from_rotvec

    def work() -> Array:
        still, walk = int(FIRST_STOP_S / log.dt), np.array([GYRO_DENSITY] * 3 + [BIAS_WALK] * 3)
        steps = turned((log.gyro - log.gyro[:still].mean(axis=0)) * log.dt).as_matrix()
        nominal = np.empty((len(log.t), 3, 3))
        nominal[0] = levelled(log.accel[:still].mean(axis=0))
        for k in range(1, len(nominal)):
            nominal[k] = nominal[k - 1] @ steps[k - 1]
        transition = np.eye(6)
        transition[:3, 3:] = -np.eye(3) * log.dt
        seen = GRAVITY * np.array([[0, -1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]], dtype=float)
        filter_ = lib.KalmanFilter(transition, np.diag(walk**2) * log.dt, seen, np.eye(3) * (GRAVITY * TILT_SIGMA) ** 2)
        data = np.full((len(log.t), 3), np.nan)
        data[::NODE] = (nominal[::NODE] @ log.accel[::NODE, :, None])[:, :, 0] - [0.0, 0.0, GRAVITY]
        start = np.diag([0.02] * 3 + [1e-4] * 3) ** 2
        x = filter_.smooth(data[None], np.zeros(6), start, observations=False).states.mean[0]
        return np.asarray(np.einsum("nji,nj->ni", nominal, turned(-x[:, :3]).as_matrix()[:, :, 2]))

    return work


def gtsam(log: Drive) -> Callable[[], Array]:
    """Batch solution of gtsam: Rot3 at 10 Hz, preintegrated gravity, magnetometer, all marginal covariances."""
    lib: Any = import_module("gtsam")

    def work() -> Array:
        parameters = lib.PreintegratedRotationParams()
        parameters.setGyroscopeCovariance(np.eye(3) * GYRO_DENSITY**2)
        graph, values = lib.NonlinearFactorGraph(), lib.Values()
        still = int(FIRST_STOP_S / log.dt)
        R, bias = lib.Rot3(levelled(log.accel[:still].mean(axis=0))), log.gyro[:still].mean(axis=0)
        up, north = lib.Unit3(np.array([0.0, 0.0, 1.0])), lib.Unit3(log.field_n)
        tilt, field = (lib.noiseModel.Isotropic.Sigma(2, sigma) for sigma in (TILT_SIGMA, FIELD_SIGMA))
        last = (len(log.t) - 1) // NODE
        values.insert(last + 1, bias)
        for k in range(last + 1):
            values.insert(k, R)
            part = slice(k * NODE, (k + 1) * NODE)
            graph.add(lib.AttitudeFactorRot3(k, up, tilt, lib.Unit3(log.accel[part].mean(axis=0))))
            graph.add(lib.AttitudeFactorRot3(k, north, field, lib.Unit3(log.mag[part.start])))
            if k < last:
                between = lib.PreintegratedAhrsMeasurements(parameters, bias)
                for rate in log.gyro[part]:
                    between.integrateMeasurement(rate, log.dt)
                graph.add(lib.AHRSFactor(k, k + 1, last + 1, between))
                R = R.compose(between.deltaRij())
        found = lib.LevenbergMarquardtOptimizer(graph, values).optimize()
        marginals = lib.Marginals(graph, found)
        for k in range(last + 1):
            marginals.marginalCovariance(k)
        return np.array([found.atRot3(k).matrix()[2] for k in range(last + 1)])

    return work


def levelled(force: Array) -> Array:
    """Return an attitude (3, 3) that puts a specific force upright, heading free."""
    z = force / np.linalg.norm(force)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def mcap_ros2(path: Path) -> Callable[[], int]:
    """mcap-ros2-support: every message an object."""
    reader, factory = import_module("mcap.reader"), import_module("mcap_ros2.decoder")

    def work() -> int:
        with path.open("rb") as stream:
            found = reader.make_reader(stream, decoder_factories=[factory.DecoderFactory()])
            return sum(1 for _ in found.iter_decoded_messages())

    return work


def rosbags(path: Path) -> Callable[[], int]:
    """rosbags: every message an object."""
    storage, types = import_module("rosbags.rosbag2.storage_mcap"), import_module("rosbags.typesys")

    def work() -> int:
        store, count = types.get_typestore(types.Stores.ROS2_HUMBLE), 0
        found = storage.McapReader(path)
        found.open()
        for connection, _, data in found.messages(found.connections):
            store.deserialize_cdr(data, connection.msgtype)
            count += 1
        found.close()
        return count

    return work


def roboto(path: Path) -> Callable[[], int]:
    """roboto-mcap-codec (Rust): Arrow batches of every channel, without the arrays of covariances."""
    codec = import_module("mcap_codec")

    def work() -> int:
        with path.open("rb") as stream:
            channels = import_module("mcap.reader").make_reader(stream).get_summary().channels
            left_out = codec.Projection(exclude=[[f"{name}_covariance"] for name in COVARIANCES])

            def part(offset: int, length: int) -> bytes:
                stream.seek(offset)
                return stream.read(length)

            count = 0
            for channel_id in channels:
                which = {"channel": codec.ChannelId(channel_id), "timestamp": codec.TimestampSource("message_log_time")}
                with codec.open_mcap_file(part, path.stat().st_size, projection=left_out, **which) as cursor:
                    count += sum(batch.num_rows for batch in cursor)
            return count

    return work


def zstandard(path: Path) -> Callable[[], int]:
    """The chunks of the file unpacked by zstandard, and nothing read in them: what no reader can be faster than."""
    unpacker = import_module("zstandard").ZstdDecompressor()

    def work() -> int:
        with path.open("rb") as stream:
            summary = import_module("mcap.reader").make_reader(stream).get_summary()
            for chunk in summary.chunk_indexes:
                stream.seek(chunk.chunk_start_offset + chunk.chunk_length - chunk.compressed_size)
                packed = stream.read(chunk.compressed_size)
                unpacker.decompress(packed, max_output_size=chunk.uncompressed_size)
            return int(summary.statistics.message_count)

    return work


FILTERS = {
    "vqf": vqf,
    "imufusion": imufusion,
    "ahrs": ahrs,
    "filterpy": filterpy,
    "simdkalman": simdkalman,
    "gtsam": gtsam,
}
READERS = {"mcap-ros2-support": mcap_ros2, "rosbags": rosbags, "roboto-mcap-codec": roboto, "zstandard": zstandard}


def inclination_deg(found: Array, log: Drive, path: Path) -> float:
    """RMS of the angle between the true vertical and the one that was found, which may be at every NODE-th sample."""
    table = import_module("pyarrow.parquet").read_table(path.with_suffix(".truth.parquet"))
    true = ups(np.stack([table[f"q_{axis}"].to_numpy() for axis in "wxyz"], axis=1))[: len(log.t)]
    if len(found) < len(true):
        true = true[::NODE][: len(found)]
    angle = np.arctan2(np.linalg.norm(np.cross(found, true), axis=1), np.sum(found * true, axis=1))
    return float(np.degrees(np.sqrt(np.mean(angle**2))))


def main() -> None:
    """Run the job."""
    name, path = sys.argv[1], Path(sys.argv[2])
    log = drive(path) if name in FILTERS else None
    work: Callable[[], Any] = FILTERS[name](log) if log is not None else READERS[name](path)
    start = time.process_time()
    found = work()
    spent = {"seconds": time.process_time() - start}
    if log is not None:
        spent |= {"rows": len(log.t), "inclination_deg": inclination_deg(found, log, path)}
    else:
        spent |= {"rows": found}
    print(json.dumps(spent))


if __name__ == "__main__":
    main()
