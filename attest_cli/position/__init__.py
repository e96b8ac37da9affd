"""Position from the smoothed attitude: wheel odometry, or inertial between stops; with the sigma that the attitude
leaves.
"""

from __future__ import annotations

from .chain import Markov, markov
from .course import Position, around, navigated, row_blocks
from .odometry import odometry_position, silences
from .strapdown import inertial_position

__all__ = [
    "Markov",
    "Position",
    "around",
    "inertial_position",
    "markov",
    "navigated",
    "odometry_position",
    "row_blocks",
    "silences",
]
