"""What can be wrong with a drive, its table, its text or its messages: changes that faults are put together from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from journeys.odd_logs import ACCEL, GYRO, Drive, quaternions
from numpy.typing import NDArray

from attest_cli.maths import rotation

Array = NDArray[np.float64]
Change = Callable[[Drive], Drive]
MAG = ("mag_x", "mag_y", "mag_z")
SUN = ("sun_x", "sun_y")
Q = ("q_w", "q_x", "q_y", "q_z")
G = 9.80665
S = 10**9


def put(drive: Drive, names: tuple[str, ...], rows: NDArray[Any], value: float) -> Drive:
    """Set cells where there is a value."""
    new = {n: np.where(rows & np.isfinite(drive.columns[n]), value, drive.columns[n]) for n in names}
    return drive.changed(**new)


def scaled(factor: float, *names: str) -> Change:
    return lambda d: d.changed(**{n: factor * d.columns[n] for n in names})


def added(amount: float, *names: str, after: float = 0.0) -> Change:
    return lambda d: d.changed(**{n: d.columns[n] + amount * (d.t >= after) for n in names})


def swapped(a: str, b: str) -> Change:
    return lambda d: d.changed(**{a: d.columns[b], b: d.columns[a]})


def chain(*changes: Change) -> Change:
    def change(d: Drive) -> Drive:
        for one in changes:
            d = one(d)
        return d

    return change


def during(start: float, end: float, names: tuple[str, ...], value: float) -> Change:
    return lambda d: put(d, names, (d.t > start) & (d.t < end), value)


def frozen(start: float, end: float, *names: str) -> Change:
    """Hold the last value."""

    def change(d: Drive) -> Drive:
        first, inside = int(np.searchsorted(d.t, start)), (d.t >= start) & (d.t < end)
        return d.changed(**{n: np.where(inside, d.columns[n][first], d.columns[n]) for n in names})

    return change


def midway(factor: float, *names: str, share: float = 0.5) -> Change:
    """Another unit from half of the drive on."""
    return lambda d: d.changed(**{n: np.where(d.t > share * d.t[-1], factor, 1.0) * d.columns[n] for n in names})


def dead(name: str, noise: float = 1e-3, share: float = 0.45) -> Change:
    """An axis of which from some time on nothing but noise is left."""

    def change(d: Drive) -> Drive:
        left = np.random.default_rng(1).normal(0.0, noise, len(d.t))
        return d.changed(**{name: np.where(d.t > share * d.t[-1], left, d.columns[name])})

    return change


def in_turn(every: int) -> Change:
    """Each so many-th row is of another IMU: the second opposite about z, the third a quarter turned."""

    def change(d: Drive) -> Drive:
        other, new = np.arange(len(d.t)) % every == 0, {}
        for x, y in (GYRO[:2], ACCEL[:2]):
            turned = (-d.columns[x], -d.columns[y]) if every == 2 else (-d.columns[y], d.columns[x])
            new |= {name: np.where(other, value, d.columns[name]) for name, value in zip((x, y), turned, strict=True)}
        return d.changed(**new)

    return change


def stale(every: int, *names: str) -> Change:
    """Repeat each measurement so many times."""

    def change(d: Drive) -> Drive:
        new = {}
        for n in names:
            new[n] = d.columns[n].copy()
            rows = np.flatnonzero(np.isfinite(new[n]))
            new[n][rows] = new[n][rows[np.arange(len(rows)) // every * every]]
        return d.changed(**new)

    return change


def outliers(share: float, *names: str, size: float = 1.0, seed: int = 5) -> Change:
    """Put other values in a share of the measurements."""

    def change(d: Drive) -> Drive:
        rng = np.random.default_rng(seed)
        rows = np.flatnonzero(np.isfinite(d.columns[names[0]]))
        hit = rng.choice(rows, max(1, round(share * len(rows))), replace=False)
        new = {n: d.columns[n].copy() for n in names}
        for n in names:
            new[n][hit] = new[n][hit] + size * rng.uniform(0.3, 1.0, len(hit)) * rng.choice([-1, 1], len(hit))
        return d.changed(**new)

    return change


def spikes(count: int, size: float, *names: str, width: int = 1) -> Change:
    def change(d: Drive) -> Drive:
        rng = np.random.default_rng(9)
        at = rng.choice(np.arange(50, len(d.t) - 50), count, replace=False)
        new = {n: d.columns[n].copy() for n in names}
        for n in names:
            for k in range(width):
                new[n][at + k] += size
        return d.changed(**new)

    return change


def clipped(level: float, *names: str) -> Change:
    return lambda d: d.changed(**{n: np.clip(d.columns[n], -level, level) for n in names})


def rounded(step: float, *names: str) -> Change:
    return lambda d: d.changed(**{n: np.round(d.columns[n] / step) * step for n in names})


def turned(roll: float, pitch: float, yaw: float) -> Change:
    R = rotation.matrix(rotation.exp_quaternion(np.radians([[roll, pitch, yaw]])))[0]
    return lambda d: d.turned(R)


def without(*names: str) -> Change:
    return lambda d: d.without(*names)


def in_motion(d: Drive) -> Drive:
    """The first motion alone."""
    begin = float(d.t[int(np.argmax(d.moving))])
    return d.span(begin + 2.0, begin + 22.0)


def blind(d: Drive) -> Drive:
    """The config says nothing of the noise, nor how the IMU sits."""
    lines = [line for line in d.config.splitlines() if not line.startswith(("mounting = [1.0", "gyro_", "accel_"))]
    return Drive(d.columns, d.truth, "\n".join(lines) + "\n")


def unmounted(d: Drive) -> Drive:
    """The config does not say how the IMU sits."""
    return d.told("mounting = [1.0, 0.0, 0.0, 0.0]\ngyro", "gyro")


def stamps(edit: Callable[[Array, NDArray[np.int64]], NDArray[np.int64]]) -> Change:
    """Other stamps: of seconds since the first row, and the stamps."""
    return lambda d: d.changed(timestamp_ns=edit(d.t, d.columns["timestamp_ns"]).astype(np.int64))


def rows(pick: Callable[[Drive], NDArray[Any]]) -> Change:
    return lambda d: d.rows(pick(d))


def late(seconds_late: float, *names: str) -> Change:
    """A sensor whose clock runs beside that of the IMU; measurements beyond the end are lost."""

    def change(d: Drive) -> Drive:
        shift = round(seconds_late / (d.t[1] - d.t[0]))
        new = {}
        for n in names:
            moved = np.roll(d.columns[n], shift)
            moved[: max(shift, 0)] = np.nan
            moved[len(moved) + min(shift, 0) :] = np.nan
            new[n] = moved
        return d.changed(**new)

    return change


def hard_iron(share: float) -> Change:
    field_ut = 47.9
    return lambda d: d.changed(
        **{n: d.columns[n] + share * field_ut * w for n, w in zip(MAG, (0.8, -0.5, 0.33), strict=True)}
    )


def soft_iron(d: Drive) -> Drive:
    m = np.stack([d.columns[n] for n in MAG], axis=1) @ (np.eye(3) + np.diag([0.25, -0.2, 0.1]))
    return d.changed(**dict(zip(MAG, m.T, strict=True)))


def repeated(d: Drive, share: int = 10) -> Drive:
    return d.rows(np.sort(np.append(np.arange(len(d.t)), np.arange(0, len(d.t), share))))


def bursts(size: int) -> Change:
    """Rows share the stamp of the last of their batch, as over USB."""
    return stamps(lambda _, ns: ns[np.minimum(np.arange(len(ns)) // size * size + size - 1, len(ns) - 1)])


def shuffled(d: Drive) -> Drive:
    order = np.arange(len(d.t))
    at = np.random.default_rng(3).choice(np.arange(10, len(order) - 10, 4), 40, replace=False)
    order[at], order[at + 1] = order[at + 1].copy(), order[at].copy()
    return d.rows(order)


def jitter(sigma: float) -> Change:
    def edit(t: Array, ns: NDArray[np.int64]) -> NDArray[np.int64]:
        noise = np.random.default_rng(4).normal(0.0, sigma * S, len(ns))
        noise[0] = 0.0
        return np.sort(ns + noise.astype(np.int64))

    return stamps(edit)


def gravity_removed(sign: float = 1.0) -> Change:
    def change(d: Drive) -> Drive:
        up = rotation.matrix(quaternions(d.truth))[:, 2] * G
        return d.changed(**{n: d.columns[n] - sign * up[:, k] for k, n in enumerate(ACCEL)})

    return change


def renamed(old: str, new: str) -> Callable[[str], str]:
    return lambda content: content.replace(old, new, 1)


def second(unit: float, digits: int | None = None, form: str = "{:.9f}", start: float = 0.0, name: str = "t") -> Any:
    """A time column of its own in another unit."""

    def edit(content: str) -> str:
        head, *lines = content.splitlines()
        first = int(lines[0].split(",", 1)[0])
        out = [head.replace('"timestamp_ns"', name, 1).replace("timestamp_ns", name, 1)]
        for line in lines:
            ns, rest = line.split(",", 1)
            out.append(f"{form.format((int(ns) - first) * 1e-9 / unit + start / unit)},{rest}")
        return "\n".join([*out, ""])

    return edit


def integers(unit_ns: int, start: int = 0, name: str = "t", modulus: int | None = None) -> Any:
    def edit(content: str) -> str:
        head, *lines = content.splitlines()
        first = int(lines[0].split(",", 1)[0])
        out = [head.replace('"timestamp_ns"', name, 1)]
        for line in lines:
            ns, rest = line.split(",", 1)
            value = (int(ns) - first) // unit_ns + start
            out.append(f"{value % modulus if modulus else value},{rest}")
        return "\n".join([*out, ""])

    return edit


def lines(edit: Callable[[list[str]], list[str]]) -> Callable[[str], str]:
    return lambda content: "\n".join([*edit(content.splitlines()), ""])


def comma(content: str) -> str:
    return content.replace(",", ";").replace(".", ",")


def zero_header(role: str, k: int, stamp: int, fields: dict[str, Any]) -> Any:
    return 0, stamp, fields


def clocks(shift_ns: int, of: str) -> Any:
    """Header stamps of one sensor on another clock; the recorder's is common."""
    return lambda role, _, stamp, fields: (stamp + shift_ns * (role == of), stamp, fields)


def covariances(value: float) -> Any:
    def edit(role: str, k: int, stamp: int, fields: dict[str, Any]) -> Any:
        new = {name: [value] * len(v) if "covariance" in name and "type" not in name else v
               for name, v in fields.items()}  # fmt: skip
        if role == "odometry":
            new["twist"] = {**fields["twist"], "covariance": [value] * 36}
        return stamp, stamp, new

    return edit


def zero_quaternion(role: str, k: int, stamp: int, fields: dict[str, Any]) -> Any:
    if role == "imu":
        fields = {**fields, "orientation": dict.fromkeys("xyzw", 0.0), "orientation_covariance": [0.0] * 9}
    return stamp, stamp, fields


def two_imus(d: Drive) -> Drive:
    new = {f"imu2_{n}": d.columns[n] * 1.001 + 0.002 for n in (*GYRO, *ACCEL)}
    return d.changed(**new)


def xyzw(d: Drive) -> Drive:
    return d.changed(**{n: d.columns[o] for n, o in zip(Q, ("q_x", "q_y", "q_z", "q_w"), strict=True)})


def conjugated(d: Drive) -> Drive:
    return scaled(-1.0, "q_x", "q_y", "q_z")(d)


def magnetic(declination: float) -> Change:
    return lambda d: d.changed(compass_deg=np.mod(d.columns["compass_deg"] - declination, 360.0))


def field_turned(declination: float) -> Change:
    """A reference of another place: the magnetic field of ``attest.toml`` turned to the east by so much, deg."""

    def change(d: Drive) -> Drive:
        line = next(line for line in d.config.splitlines() if line.startswith("magnetic_field_ut"))
        f = np.array([float(x) for x in line.split("[")[1].rstrip("]").split(",")])
        R = rotation.matrix(rotation.exp_quaternion(np.radians([[0.0, 0.0, -declination]])))[0]
        return d.told(line, f"magnetic_field_ut = {(R @ f).tolist()}")

    return change


def sun_field(turn_deg: float) -> Change:
    """A reference direction that is wrong."""

    def change(d: Drive) -> Drive:
        line = next(line for line in d.config.splitlines() if line.startswith("sun_direction"))
        s = np.array([float(x) for x in line.split("[")[1].rstrip("]").split(",")])
        R = rotation.matrix(rotation.exp_quaternion(np.radians([[turn_deg, 0.0, 0.0]])))[0]
        return d.told(line, f"sun_direction = {(R @ s).tolist()}")

    return change


def steady(d: Drive) -> Drive:
    """A drive that never moves, at its first attitude."""
    rng, n = np.random.default_rng(1), len(d.t)
    force = rotation.matrix(quaternions(d.truth)[:1])[0].T @ np.array([0.0, 0.0, G])
    new = {name: 0.003 * (k - 1) + rng.normal(0.0, 1e-3, n) for k, name in enumerate(GYRO)}
    new |= {name: f + rng.normal(0.0, 0.014, n) for name, f in zip(ACCEL, force, strict=True)}
    held = {name: np.full(n, d.truth[name][0]) for name in Q}
    return Drive(d.columns | new, d.truth | held, d.config)


def averaged(size: int) -> Change:
    """A slower sensor: means over so many samples, at their middle."""

    def change(d: Drive) -> Drive:
        n = len(d.t) // size * size
        picked = d.rows(np.arange(size // 2, n, size))
        new = {k: d.columns[k][:n].reshape(-1, size).mean(axis=1) for k in (*GYRO, *ACCEL)}
        q = quaternions(d.truth)[:n].reshape(-1, size, 4).mean(axis=1)  # what such a sensor can know
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        return Drive(picked.columns | new, picked.truth | dict(zip(Q, q.T, strict=True)), d.config)

    return change


def sun_turned(d: Drive, angle: float) -> Drive:
    """A sun sensor that is turned about its boresight."""
    a, (x, y) = np.radians(angle), (d.columns[n] for n in SUN)
    return d.changed(sun_x=np.cos(a) * x - np.sin(a) * y, sun_y=np.sin(a) * x + np.cos(a) * y)


def cut(share: float) -> Any:
    return lambda content: content[: int(share * len(content))]
