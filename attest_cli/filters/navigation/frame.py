"""Whether fixes are in the axes and the unit that they should be: their path against the one that the IMU feels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...maths import rotation
from ...records import Array, Imu, Log, Warn
from .. import Drive
from .aids import Place, Wheels
from .fixes import possible
from .rounds import Navigated, smoothed_begin
from .start import apart, heading_of_wheels, heading_offset, lag_of, path_felt, second

SPACINGS_S = (0.5, 1.0, 2.0)  # of the fixes that are compared: a vehicle turns slower than a hand
LAGS_S = np.arange(-1.0, 1.01, 0.05)  # by which their stamps may be late
LEAST = 20  # changes of velocity
COHERENT, ASIDE = 0.9, 0.8  # share of the squares that a path explains; and along its narrowest direction
ASKEW = np.radians(20.0)  # a lever arm that swings may turn the path by some of it
UNIT = 2.0  # a lever arm that swings may stretch it by some of it; units differ by more
DOWN = np.radians(160.0)
HEADINGS = ("magnetometer", "compass", "sun", "orientation")  # sensors of it
AWAY, SURE = np.radians(15.0), 5.0  # of a heading from the way of the fixes that is told; in sigmas of theirs
NEAR, AGREE = np.radians(3.0), 2.0  # the same of one that agrees with them in the end
LEG_S, LEAST_LEGS = 5.0, 10  # between fixes that velocities are held against
CLEARLY, FACTOR = 0.3, 1.25  # of what is left by the way as it is; knots, mph, km/h and ft/s differ by more
HINT = "positions are metres east, north and up: mend their source"


@dataclass(frozen=True, slots=True)
class Frame:
    """How fixes :math:`z` and the path :math:`w` that the IMU feels agree best: :math:`z=sQw`, ``Q`` (3, 3)
    orthogonal.
    """

    Q: Array
    scale: float

    @property
    def mirrored(self) -> bool:
        """Whether no turn makes one of the other."""
        return bool(np.linalg.det(self.Q) < 0.0)

    @property
    def off_up(self) -> float:
        """Angle of their third axis to the vertical, rad."""
        return float(np.arccos(np.clip(self.Q[2, 2], -1.0, 1.0)))


def frame_of(imu: Imu, t: Array, q: Array, place: Place, gravity: float) -> Frame | None:
    r"""Return how the fixes lie to the path that the IMU feels, or None where they do not show it.

    Between three fixes the change of the mean velocity is free of position and velocity; of the changes seen :math:`z`
    and felt :math:`w` the orthogonal Procrustes problem (Schoenemann 1966) gives

    .. math:: \sum zw^T=U\Sigma V^T,\quad Q=UV^T,\quad s=\mathrm{tr}\,\Sigma/\sum|w|^2,\quad
        \gamma=(\mathrm{tr}\,\Sigma)^2/(\sum|z|^2\sum|w|^2)

    at the lag of the largest coherence :math:`\gamma`. A flat path does not tell a mirror image from a turn.

    Parameters
    ----------
    t, q : (n,), (n, 4) nodes and their attitude
    gravity : m/s^2
    """
    path, best, found = path_felt(imu, t, q, gravity), COHERENT, None
    for spacing in SPACINGS_S:
        rows = np.array(apart(place.t, spacing)) if len(place.t) else np.zeros(0, dtype=np.int64)
        for lag in LAGS_S:
            when = place.t[rows] - lag
            inside = rows[(when > t[0]) & (when < t[-1])]
            if len(inside) < LEAST + 2:
                continue
            when = place.t[inside] - lag
            felt = second(when, np.stack([np.interp(when, imu.t, path[:, i]) for i in range(3)], axis=1))
            seen = second(when, place.place_n[inside])
            known = np.isfinite(seen).all(axis=1)
            coherence, frame = _agreed(seen[known], felt[known])
            if coherence > best and frame is not None:
                best, found = coherence, frame
    return found


def far_lags(log: Log, done: Navigated) -> dict[str, float]:
    """Return how late fixes are, s, that are further off than is corrected."""
    t, (q, _) = done.nodes.t, smoothed_begin(done)
    places = [aid for aid in done.problem.aids if isinstance(aid, Place)]
    lags = {place.role: lag_of(log.imu, t, q, place) for place in places}
    return {role: lag + done.learnt.lags.get(role, 0.0) for role, lag in lags.items() if lag}


def of_receiver(drive: Drive) -> list[Warn]:
    r"""Say where the velocities of a receiver do not lead along its own fixes.

    Of legs between fixes, :math:`z` in the complex plane, and the integral :math:`w` of the velocity over them

    .. math:: z=cw,\quad c=\sum z\bar w/\sum|w|^2

    tells scale and turn, and the same with :math:`\bar w` a mirror image.
    """
    fixes = drive.log.fixes
    if not {"gps", "gps_velocity"} <= fixes.keys():
        return []
    use, place, _ = possible(drive, "gps")
    t, p, v = fixes["gps"].t[use], place[use], fixes["gps_velocity"]
    rows = np.array(apart(t, LEG_S)) if len(t) else np.zeros(0, dtype=np.int64)
    rows = rows[(t[rows] >= v.t[0]) & (t[rows] <= v.t[-1])]
    if len(rows) < LEAST_LEGS + 1:
        return []
    steps = 0.5 * (v.values[1:] + v.values[:-1]) * np.diff(v.t)[:, None]
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    led = np.diff(np.stack([np.interp(t[rows], v.t, way[:, i]) for i in range(3)], axis=1), axis=0)
    facts = _of_way(np.diff(p[rows], axis=0), led)
    hint = "velocities are m/s east, north and up (or down): mend the names, with --columns, or the unit"
    message = f"the velocities of gps {' and '.join(facts)}"
    return [Warn("gps-velocity-contradicted", message, hint, fatal=True)] if facts else []


def _of_way(seen: Array, led: Array) -> list[str]:
    """Say how legs of velocity ``led`` (k, 3) differ from those of fixes, ``seen`` (k, 3)."""
    z, w = (legs[:, :2] @ np.array([1.0, 1.0j]) for legs in (seen, led))
    size = max(float(np.sum(np.abs(z) ** 2) * np.sum(np.abs(w) ** 2)), 1e-300)
    turned, flipped = (np.abs(np.sum(z * np.conj(x))) ** 2 / size for x in (w, np.conj(w)))
    facts = []
    if flipped > COHERENT and 1.0 - flipped < CLEARLY * (1.0 - turned):
        facts.append("are a mirror image of the way of its fixes")
    elif turned > COHERENT:
        c = np.sum(z * np.conj(w)) / np.sum(np.abs(w) ** 2)
        if not 1.0 / FACTOR < np.abs(c) < FACTOR:
            facts.append(f"go {1.0 / np.abs(c):.3g} times as far as its fixes")
        if np.abs(np.angle(c)) > AWAY:
            facts.append(f"are turned {np.degrees(np.abs(np.angle(c))):.0f} deg against its fixes")
    up, rises = seen[:, 2], led[:, 2]
    size = max(float(np.sum(up**2) * np.sum(rises**2)), 1e-300)
    if up @ rises < 0.0 and (up @ rises) ** 2 > ASIDE * size:
        facts.append("rise where its fixes sink")
    return facts


def contradicted(log: Log, done: Navigated, gravity: float) -> Iterator[Warn]:
    """Say where fixes contradict the axes, or the heading, that the other sensors show.

    Both are held against the attitude that no fix has bent yet. Where the heading has followed the fixes in the end, a
    magnetometer was overruled, and the track does not suffer.
    """
    t, aids = done.nodes.t, done.problem.aids
    q, _ = smoothed_begin(done)
    places = [aid for aid in aids if isinstance(aid, Place)]
    for place in places:
        frame = frame_of(log.imu, t, q, place, gravity)
        told = [] if frame is None else doubts(place.role, frame)
        yield from told
        if told:
            return  # its heading is that of other axes
    sensors = [role for role in HEADINGS if role in log.fixes]
    if not places or not sensors or done.begun.run.heading != "absolute":
        return
    begun, sigma = _off(log, done, q, places[0])
    least = max(AWAY, SURE * sigma)
    if abs(begun) > least:
        role, names = places[0].role, " and ".join(sensors)
        message = f"heading by {names} is {np.degrees(abs(begun)):.0f} deg off the way of the fixes of {role}"
        hint = f"which of them is wrong? check sign, mounting and reference of the one, the axes of {role}"
        turn = rotation.multiply(done.found.smoothed.q, rotation.conjugate(q))  # what became of it in the end
        left = float(np.angle(np.exp(1j * begun) * np.mean((turn[:, 0] - 1j * turn[:, 3]) ** 2)))
        near = min(AWAY, max(NEAR, AGREE * sigma))
        overruled = sensors == ["magnetometer"] and role == "gps" and abs(left) < near
        yield Warn("heading-contradicted", message, hint, fatal=not overruled)


def _off(log: Log, done: Navigated, q: Array, place: Place) -> tuple[float, float]:
    """Return the turn about the vertical, rad, from an attitude ``q`` (n, 4) to the way of the fixes, and its sigma."""
    t = done.nodes.t
    turn, sigma = heading_offset(log.imu, t, q, np.zeros(3), place, drifts=False)
    by_path = [heading_of_wheels(t, q, aid, place) for aid in done.problem.aids if isinstance(aid, Wheels)]
    return min([(float(turn[0]), sigma), *by_path], key=lambda way: way[1])


def _agreed(seen: Array, felt: Array) -> tuple[float, Frame | None]:
    """Return the coherence of changes of velocity (k, 3), and the frame if all its directions are shown."""
    squares = float(np.sum(seen**2) * np.sum(felt**2))
    if len(seen) < LEAST or squares == 0.0:
        return 0.0, None
    U, size, V = np.linalg.svd(seen.T @ felt)
    narrow, wide = seen @ U[:, 2], felt @ V[2]
    aside = float(narrow @ wide) ** 2 / max(float(np.sum(narrow**2) * np.sum(wide**2)), 1e-300)
    frame = Frame(U @ V, float(size.sum() / np.sum(felt**2)))
    return float(size.sum()) ** 2 / squares, frame if aside > ASIDE else None


def doubts(role: str, frame: Frame) -> list[Warn]:
    """Say which axes or which unit the fixes cannot be in."""
    facts = []
    if not 1.0 / UNIT < frame.scale < UNIT:
        facts.append(f"go {frame.scale:.3g} times as far as the accelerometer feels")
    if frame.off_up > DOWN:
        facts.append("count height downwards")
    elif frame.off_up > ASKEW:
        facts.append(f"have a third axis that is {np.degrees(frame.off_up):.0f} deg from the vertical")
    elif frame.mirrored:
        facts.append("are a mirror image of the path that the IMU feels")
    return [Warn(f"{role}-frame", f"the fixes of {role} {' and '.join(facts)}", HINT, fatal=True)] if facts else []
