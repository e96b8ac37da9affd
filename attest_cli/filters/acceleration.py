r"""How much the accelerometer says of the vertical while the body accelerates: Rehbinder & Hu, section 1.2.4.

The noise density is :math:`q_2=(1+\varphi)\bar q_2` (1.43), with :math:`\varphi` a function of how far the specific
force was from the vertical lately (1.46).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..records import Array

Kind = Literal["constant", "switching", "continuous"]
SWITCHED = 1e4  # factor on the noise above the threshold: nothing is measured there


@dataclass(frozen=True, slots=True)
class Rule:
    r"""A rule of the acceleration noise.

    ``density`` :math:`\bar q_2`, 1/Hz (shares of g, squared); ``limit`` a share of g: the threshold of ``switching``
    (1.47: printed as zero, which noise never is), the acceleration that doubles the noise of ``continuous``
    (:math:`1/\alpha` of 1.48); ``window`` :math:`T_0`, s.
    """

    kind: Kind
    density: float
    limit: float = np.inf
    window: float = 0.0

    def factor(self, w: Array) -> Array:
        r"""Return :math:`1+\varphi` (n,) of the windowed acceleration ``w`` (n,), a share of g."""
        if self.kind == "constant":
            return np.ones(len(w))
        if self.kind == "switching":
            return np.where(w > self.limit, 1.0 + SWITCHED, 1.0)
        return np.asarray(1.0 + (w / self.limit) ** 2)

    def causal(self, dt: float) -> Causal:
        """Return the rule for a running filter whose samples are ``dt`` s apart."""
        return Causal(self, deque(maxlen=1 + round(self.window / dt)))


@dataclass(frozen=True, slots=True)
class Causal:
    r"""A rule fed one residual at a time: :math:`\hat w=\max_{[t-T_0,t]}\|y-\hat x^-\|` (1.46), x predicted."""

    rule: Rule
    lately: deque[float]

    def __call__(self, _sample: int, w: float) -> float:
        """Take in a sample's residual and return the factor on the noise."""
        self.lately.append(w)
        most = max(self.lately)
        if self.rule.kind == "constant":
            return 1.0
        if self.rule.kind == "switching":
            return 1.0 + SWITCHED if most > self.rule.limit else 1.0
        return 1.0 + (most / self.rule.limit) ** 2


def windowed(w: Array, window: float, dt: float) -> Array:
    r"""Return the largest of ``w`` (n,) within ``window`` / 2 either side: (1.46) after the drive, :math:`T_0` long."""
    from scipy.ndimage import maximum_filter1d

    reach = round(0.5 * window / dt)
    return np.asarray(maximum_filter1d(w, 2 * reach + 1, mode="nearest")) if reach else w
