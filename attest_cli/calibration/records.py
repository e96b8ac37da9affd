"""What a calibration holds: frozen records that the numbers are put in and that pages and files are made from.

SI and radians throughout; one entry per body axis where a field is a tuple of three.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..records import Array


@dataclass(frozen=True, slots=True)
class Rest:
    """The rates of one axis at rest, as blocks: ``t`` (m,) s since the start of the log, ``rate`` (m,) mean of each
    block, ``sigma`` (m,) its noise, ``stop`` (m,) number of the stop it lies in, ``temperature`` (m,) deg C or None.
    """

    t: Array
    rate: Array
    sigma: Array
    stop: Array
    temperature: Array | None = None


@dataclass(frozen=True, slots=True)
class BiasModel:
    """A fitted model of one axis' bias.

    ``name``: constant, ramp, exponential, temperature, random-walk. ``values`` and ``covariance`` (p, p) in the order
    of ``names`` (for example ``C1, C2, T``: rad/s, rad/s, s; of the random walk the bias at the last block and the K it
    was followed with); ``fitted`` (m,) and ``sigma`` (m,) at the blocks of ``Rest``, with the random walk that was seen
    or could hide in what the curve leaves; ``bic`` lower is better; ``walk`` K of the random walk that stands beside
    the curve, in the mean of its likelihood; ``notes`` honest refusals such as a record too short for ``T``.
    """

    name: str
    names: tuple[str, ...]
    values: Array
    covariance: Array
    fitted: Array
    sigma: Array
    bic: float
    notes: tuple[str, ...] = ()
    walk: float = 0.0


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Of a residual: autocorrelation ``rho`` (M,) at lags 1..M, 95 % band of white noise ``band`` (M,), share inside,
    Ljung-Box statistic and its probability; ``white``: both tests pass; ``lag_s`` seconds per lag.
    """

    rho: Array
    band: Array
    inside: float
    ljung_box: float
    probability: float
    white: bool
    lag_s: float


@dataclass(frozen=True, slots=True)
class Allan:
    """Overlapping Allan deviation: ``tau`` (k,) s, ``deviation`` (k,) in the unit of the signal, 95 % interval ``low``,
    ``high`` (k,), ``n`` (k,) terms.
    """

    tau: Array
    deviation: Array
    low: Array
    high: Array
    n: Array


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """White noise ``N`` (unit/sqrt(Hz)) and random walk ``K`` (unit/s/sqrt(Hz)) by maximum likelihood, each with its 95
    % interval; ``B`` bias instability read off the Allan minimum (no interval: it is read, not fitted); None = not seen
    or the record is too short, and ``notes`` says which. The interval of a K that is not seen is from 0 to its bound.
    """

    N: float
    N_interval: tuple[float, float]
    K: float | None
    K_interval: tuple[float, float] | None
    B: float | None
    B_tau: float | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Axis:
    """One gyro axis: its rates at rest, the chosen model and all that were tried, whiteness of the residual, Allan
    deviation and noise; ``fine``: the rates over means of a second, for the eye.
    """

    rest: Rest
    model: BiasModel
    models: Mapping[str, BiasModel]
    whiteness: Whiteness
    allan: Allan
    noise: NoiseFit
    fine: Rest


@dataclass(frozen=True, slots=True)
class Accelerometer:
    """``a = matrix (raw + bias)``: ``matrix`` (3, 3) = T K (upper triangular misalignment times scale), ``bias`` (3,)
    m/s^2 or None where the attitudes are too few; ``noise`` per axis; ``residual`` m/s^2 rms of the norm;
    ``attitudes`` at rest that differ; ``tilt_sigma`` rad, what the fit leaves of the tilt.
    """

    noise: tuple[NoiseFit, NoiseFit, NoiseFit]
    matrix: Array | None
    bias: Array | None
    residual: float | None
    attitudes: int
    notes: tuple[str, ...] = ()
    tilt_sigma: float | None = None


@dataclass(frozen=True, slots=True)
class Magnetometer:
    """``m = matrix (raw - offset)``: soft iron ``matrix`` (3, 3) symmetric, hard iron ``offset`` (3,) tesla;
    ``residual`` rms share of the field; ``coverage`` share of the sphere seen.
    """

    matrix: Array
    offset: Array
    field: float
    residual: float
    coverage: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """All that ``attest calibrate-bias`` found. ``duration`` s from first to last sample, ``at_rest`` s of it used;
    ``rate_hz`` of the IMU; ``static``: the whole record stands still; ``t0_ns`` of the log.
    """

    axes: tuple[Axis, Axis, Axis]
    accelerometer: Accelerometer
    magnetometer: Magnetometer | None
    duration: float
    at_rest: float
    rate_hz: float
    static: bool
    t0_ns: int
    notes: tuple[str, ...] = ()
