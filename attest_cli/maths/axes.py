"""Axes named and signed in other ways: what a driver makes of a sensor that is mounted otherwise."""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@lru_cache(maxsize=1)
def signed_permutations() -> tuple[Array, ...]:
    """Return the 48 ways (3, 3) to name and sign three axes; half of them are left-handed."""
    return tuple(
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    )


def changed(axes: Array) -> int:
    """Return how many axes differ, of the gyro or of an accelerometer that looks the same, whichever are fewer."""
    return min(int(np.sum(np.diag(M) != 1.0)) for M in _readings(axes).values())


def _readings(axes: Array) -> dict[str, Array]:
    r"""Return what mends each sensor alone: :math:`-P^T` on the accelerometer does what a right-handed :math:`P` does
    on the gyro.
    """
    return {"gyro": axes} | ({"accelerometer": -axes.T} if np.linalg.det(axes) > 0.0 else {})


def in_words(axes: Array) -> str:
    """Tell which axes of a gyro or of an accelerometer must be changed, whichever are fewer, so that both agree.

    ``axes`` (3, 3): those of the gyro that turn gravity as the accelerometer sees it.
    """
    if np.array_equal(axes, -np.eye(3)):
        return "the gyro is reversed, or the axes of both are left-handed"
    sensor, M = min(_readings(axes).items(), key=lambda pair: int(np.sum(np.diag(pair[1]) != 1.0)))
    return f"they would agree, were the {sensor}'s x, y, z its {axes_in_words(M)}"


def axes_in_words(axes: Array) -> str:
    """Name the signed axes of the rows, as ``y, -x, z``."""
    return ", ".join(f"{'-' if row.sum() < 0.0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in axes)
