"""Every setting with its unit, its default and where that comes from. The config schema is generated from here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from .units import convert

EARTH_GRAVITY_M_S2 = 9.80665  # standard gravity, 3rd CGPM 1901
MARS_GRAVITY_M_S2 = 3.72076  # mean surface gravity of Mars

Role = Literal[
    "imu",
    "gyro",
    "accel",
    "sun",
    "magnetometer",
    "compass",
    "orientation",
    "odometry",
    "gps",
    "position",
    "temperature",
]


@dataclass(frozen=True)
class Unit:
    """The unit a number is kept in; strings with a unit of the same kind are converted (``"0.3 deg/sqrt(hr)"``)."""

    name: str

    def _parse(self, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError(f"should be a number in {self.name}")  # noqa: TRY004 (pydantic collects ValueError only)
        return convert(value, self.name) if isinstance(value, str) else value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read a string with a unit before pydantic checks the number."""
        return core_schema.no_info_before_validator_function(self._parse, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """A number, or a string with a unit."""
        text = {
            "type": "string",
            "pattern": r"^\s*[+-]?[0-9.]",
            "description": f"with a unit, converted to {self.name}",
        }
        return {"anyOf": [handler(schema), text], "x-unit": self.name}


_finite = Field(allow_inf_nan=False)
_positive = Field(gt=0, allow_inf_nan=False)
_not_negative = Field(ge=0, allow_inf_nan=False)

Seconds = Annotated[float, _not_negative, Unit("s")]
PositiveSeconds = Annotated[float, _positive, Unit("s")]
Degrees = Annotated[float, _positive, Unit("deg")]
Angle = Annotated[float, _not_negative, Unit("deg")]
Metres = Annotated[float, _positive, Unit("m")]
Altitude = Annotated[float, Field(ge=-20_000, le=100_000), Unit("m")]
Latitude = Annotated[float, Field(ge=-90, le=90), Unit("deg")]
Longitude = Annotated[float, Field(ge=-180, le=360), Unit("deg")]
Speed = Annotated[float, _positive, Unit("m/s")]
Acceleration = Annotated[float, _positive, Unit("m/s^2")]
Rate = Annotated[float, _positive, Unit("rad/s")]
GyroDensity = Annotated[float, _positive, Unit("rad/s/sqrt(Hz)")]
GyroWalk = Annotated[float, _positive, Unit("rad/s^2/sqrt(Hz)")]
AccelDensity = Annotated[float, _positive, Unit("m/s^2/sqrt(Hz)")]
AccelWalk = Annotated[float, _positive, Unit("m/s^3/sqrt(Hz)")]
Ratio = Annotated[float, _not_negative, Unit("1")]
Frequency = Annotated[float, _positive, Unit("Hz")]
AngleDensity = Annotated[float, _positive, Unit("deg/sqrt(s)")]
JerkDensity = Annotated[float, _positive, Unit("deg/s^3.5")]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def _numbers(value: object, count: int, what: str) -> tuple[float, ...]:
    """Check for exactly ``count`` finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"should be {count} numbers: {what}")
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value):
        raise ValueError(f"should be {count} finite numbers: {what}")
    return tuple(float(v) for v in value)


def _direction(value: object) -> object:
    """Scale a direction to unit length."""
    if value is None:
        return None
    vector = _numbers(value, 3, "east, north, up")
    norm = math.hypot(*vector)
    if norm == 0.0:
        raise ValueError("should not be zero: it is a direction")
    return tuple(v / norm for v in vector)


def _lever(value: object) -> object:
    return _numbers(value, 3, "x, y, z in metres")


def _field(value: object) -> object:
    return None if value is None else _numbers(value, 3, "east, north, up, in microtesla")


def _quaternion(value: object) -> object:
    """Check for a unit quaternion to 1 % and scale it to unit length."""
    if value == "auto":
        return value
    q = _numbers(value, 4, "w, x, y, z")
    norm = math.hypot(*q)
    if abs(norm - 1.0) > 0.01:
        raise ValueError(f"should be a unit quaternion w, x, y, z; its norm is {norm:.4g}")
    return tuple(v / norm for v in q)


def _passes(value: object) -> object:
    """``auto`` or a count; digits as text are a count too."""
    if isinstance(value, str) and value.strip().isdigit():
        value = int(value)
    if value == "auto" or (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 50):
        return value
    raise ValueError("should be auto or a count of 1 to 50")


def _formats(value: object) -> object:
    """A list, or names between commas."""
    names = [n.strip() for n in value.split(",")] if isinstance(value, str) else value
    if isinstance(names, list | tuple):
        if not names:
            raise ValueError("should name at least one format")
        return tuple(dict.fromkeys(names))
    return names


class Section(BaseModel):
    """One table of ``attest.toml``: frozen, and it knows its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class World(Section):
    """The world: gravity, reference directions, the frame of the outputs."""

    frame: Literal["enu", "ned"] = Field("enu", description="axes of the outputs; REP-103: east, north, up")
    body: Literal["earth", "mars"] = Field("earth", description="where the drive was: gravity and the sun's path")
    gravity_m_s2: Acceleration = Field(EARTH_GRAVITY_M_S2, description='standard gravity; 3.72076 with body = "mars"')
    sun_direction: Annotated[Vector | None, BeforeValidator(_direction)] = Field(
        None, description="direction to the sun (east, north, up); none: from latitude, longitude and the log's time"
    )
    latitude_deg: Latitude | None = Field(None, description="for sun and magnetic field; north positive")
    longitude_deg: Longitude | None = Field(None, description="for sun and magnetic field; east positive")
    altitude_m: Altitude = Field(0.0, description="height above the ellipsoid")
    magnetic_field_ut: Annotated[Vector | None, BeforeValidator(_field)] = Field(
        None, description="microtesla (east, north, up); none: World Magnetic Model at the place and time"
    )

    @model_validator(mode="before")
    @classmethod
    def _gravity_of_the_body(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("body") == "mars":
            return {"gravity_m_s2": MARS_GRAVITY_M_S2, **data}
        return data

    @model_validator(mode="after")
    def _whole_place(self) -> Self:
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise ValueError("latitude_deg and longitude_deg belong together: give both or none")
        return self


class Imu(Section):
    """The inertial sensor: where it sits and how noisy it is."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    mounting: Annotated[Quaternion | Literal["auto"], BeforeValidator(_quaternion)] = Field(
        "auto", description="q body <- sensor (w, x, y, z); auto: the IMU's axes unless the log shows the vehicle's"
    )
    gyro_noise_density: GyroDensity | None = Field(None, description="noise of the rate; none: from the log's stops")
    gyro_random_walk: GyroWalk | None = Field(None, description="walk of the bias; none: from the log's stops")
    accel_noise_density: AccelDensity | None = Field(
        None, description="noise of the specific force; none: from the log's stops"
    )
    gyro_scale_sigma: Ratio | None = Field(
        None, description="scale and misalignment of the gyro, 1 sigma; none: 0 with a stated density, else 0.003"
    )
    accel_scale_sigma: Ratio = Field(0.0, description="scale of the accelerometer axes, 1 sigma; 0: not a state")
    accel_random_walk: AccelWalk = Field(1e-4, description="walk of the accelerometer bias; a consumer MEMS sensor")
    gyro_bias_sigma: Rate = Field(0.02, description="bias at the start, 1 sigma; 1.1 deg/s, a consumer MEMS gyro")
    accel_bias_sigma: Acceleration = Field(
        0.02, description="accelerometer bias, 1 sigma; 2 mg, a calibrated MEMS accelerometer"
    )
    noise_file: Path | None = Field(None, description="Kalibr imu.yaml, relative to the config file")
    calibration: Path | None = Field(
        None, description="calibration.toml of attest calibrate-bias, relative to the config file; what is stated wins"
    )
    gyro_samples: Literal["point", "interval"] = Field(
        "point", description="a gyro sample is the rate at its stamp (trapezoid) or the mean since the stamp before"
    )


class Sun(Section):
    """A sun sensor, or any sensor of one known direction."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_deg: Degrees = Field(0.5, description="noise per axis; the sun sensor of Roumeliotis et al. 1999")
    mounting: Annotated[Quaternion, BeforeValidator(_quaternion)] = Field(
        (1.0, 0.0, 0.0, 0.0), description="q body <- sensor (w, x, y, z)"
    )
    components: Literal[2, 3] | None = Field(
        None, description="2: projection across the boresight (sensor z); 3: unit vector; none: as the log has"
    )
    min_angle_deg: Angle = Field(
        10.0, description="no update with the sun nearer to the vertical: its heading is singular there"
    )
    field_of_view_deg: Degrees | None = Field(None, description="half angle about the boresight; none: no limit")


class Magnetometer(Section):
    """A magnetometer, used for heading."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_deg: Degrees = Field(2.0, description="heading error of one place, shared by all samples of a stop")


class Compass(Section):
    """A compass that gives heading from true north."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_deg: Degrees = Field(3.0, description="noise of one reading; a field compass")


class Orientation(Section):
    """Absolute orientation from elsewhere; never used unless mapped."""

    channel: str | None = Field(None, description="topic or column group; none: not used")
    sigma_deg: Degrees = Field(2.0, description="noise per axis of one reading")


class Odometry(Section):
    """Speed or velocity of the vehicle in body axes."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_m_s: Speed = Field(0.05, description="noise of the forward speed; wheel odometry at 10 to 20 Hz")
    lateral_sigma_m_s: Speed = Field(0.05, description="sideways and vertical slip of a wheeled vehicle")
    scale_sigma: Ratio = Field(0.03, description="scale error, 1 sigma; tyre pressure and load")


class Gps(Section):
    """Satellite positions."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_m: Metres | None = Field(None, description="noise per axis; none: as the log states, else 3 m")


class Stops(Section):
    """The stop detector, or stops given by hand."""

    file: Path | None = Field(
        None, description="CSV with start_s, end_s, relative to the config file: overrides the detector"
    )
    min_stop_s: Seconds = Field(2.0, description="shorter stops are motion; found on simulated drives")
    min_motion_s: Seconds = Field(0.5, description="shorter motions are part of the stop; found on simulated drives")
    window_s: PositiveSeconds = Field(1.0, description="window of the statistic; found on simulated drives")
    enter: Annotated[float, _positive] | None = Field(
        None, description="a stop begins below this value of the statistic; none: from the noise and the log's floor"
    )
    leave_factor: Annotated[float, Field(ge=1, allow_inf_nan=False)] = Field(
        2.0, description="a stop ends above enter times this; found on simulated drives"
    )
    use_odometry: bool = Field(True, description="let odometry confirm stops where the log has it")


class Smoothing(Section):
    """Filter, smoother and what counts when."""

    filter: Literal[
        "auto", "indirect", "navigation", "tilt-ekf", "pseudo-linear", "projected", "geometric", "heading"
    ] = Field("auto", description="forward filter; auto: indirect")
    smoother: Literal["two-filter", "rts", "paper", "none"] = Field(
        "two-filter",
        description="two-filter and rts: the same optimum; paper: the literal procedure; none: forward only",
    )
    iterations: Annotated[int | Literal["auto"], BeforeValidator(_passes)] = Field(
        "auto",
        description="Gauss-Newton passes; auto: where a start in motion or far-off passes ask for them",
    )
    node_spacing_s: PositiveSeconds = Field(
        0.1, description="largest step between nodes; error far below the noise at 100 Hz"
    )
    absolute: Literal["auto", "stops", "always"] = Field(
        "auto", description="when absolute sensors count; auto: gravity and magnetometer at stops, directions always"
    )
    stop_threshold_deg: Degrees = Field(2.0, description="attitude sigma at which the rover should have stopped")
    gate_probability: Annotated[float, Field(gt=0, le=1)] = Field(
        0.9999, description="share of good measurements the gate lets through; 1: no gate"
    )
    zero_rate: bool = Field(True, description="the gyro's mean at a stop measures its bias")
    position: Literal["auto", "strapdown", "literal", "odometry", "none"] = Field(
        "auto", description="auto: odometry if there, else strapdown; literal: eqs 41-44 of Roumeliotis et al. 1999"
    )


class Navigation(Section):
    """The navigation smoother: attitude, velocity, position and sensor errors together."""

    motion: Literal["auto", "handheld", "static", "rover", "vehicle", "drone"] = Field(
        "auto", description="weak bounds on speed and place where no sensor gives them; auto: from sensors and rates"
    )


class TiltEkf(Section):
    """The filter of Vaganay et al. 1993: roll and pitch from accelerometer and gyro angles."""

    lever_arm_m: Annotated[Vector, BeforeValidator(_lever)] = Field(
        (0.0, 0.0, 0.0), description="place of the accelerometer from the vehicle's reference point, body axes, metres"
    )
    cutoff_hz: Frequency = Field(
        10.0, description="Butterworth low-pass of specific force, speed and rates; Vaganay et al. 1993"
    )
    accel_noise_density: AccelDensity | None = Field(
        None, description="of the specific force in motion, after compensation; none: from the log's motions"
    )
    angle_noise_density: AngleDensity | None = Field(
        None, description="how the vehicle tilts: a random walk; none: its largest rate in the log, taken for usual"
    )
    gate_sigmas: Ratio = Field(
        3.0, description="a component of gravity further off than this many sigma counts less; 0: no gate"
    )


class Heading(Section):
    """The filter of Barshan and Durrant-Whyte 1994: heading from one gyro axis and a model of its bias."""

    form: Literal["auto", "six-state", "indirect"] = Field(
        "auto", description="six-state: as in the paper; indirect: bias from the stops; auto: indirect if the log stops"
    )
    c1_deg_s: Annotated[float, _finite, Unit("deg/s")] | None = Field(
        None, description="bias C1 (1 - exp(-t/T)) + C2 about the vertical, t since the start; none: a random walk"
    )
    c2_deg_s: Annotated[float, _finite, Unit("deg/s")] | None = Field(None, description="see c1_deg_s")
    time_constant_s: PositiveSeconds | None = Field(None, description="T of c1_deg_s")
    parameter_sigma: Ratio = Field(
        0.07, description="spread of C1 and C2 from run to run, a share; 7 % explains the paper's 5 deg in 10 min"
    )
    jerk_density: JerkDensity = Field(
        30.0, description="of the fourth derivative of the heading; follows steps of 30 deg/s within two samples"
    )

    @model_validator(mode="after")
    def _whole_model(self) -> Self:
        if len({value is None for value in (self.c1_deg_s, self.c2_deg_s, self.time_constant_s)}) > 1:
            raise ValueError("c1_deg_s, c2_deg_s and time_constant_s belong together: give all or none")
        return self


class Vertical(Section):
    """The filters of Rehbinder and Hu: pseudo-linear, projected, geometric."""

    acceleration: Literal["auto", "constant", "switching", "continuous"] = Field(
        "auto", description="rule of the acceleration noise, eqs 1.43-1.48; auto: by the log's innovation likelihood"
    )
    acceleration_density: AccelDensity | None = Field(
        None, description="noise of the specific force in motion, where it counts in full; none: from the log"
    )
    acceleration_limit: Acceleration | None = Field(
        None, description="switching: threshold; continuous: what doubles the noise, 1/alpha; none: from the log"
    )
    window_s: Seconds | None = Field(None, description="window T0 of the acceleration, eq 1.46; none: from the log")
    gyro_bias: bool = Field(True, description="estimate the gyro bias too; the paper does not")
    gain: Literal["matrix", "scalar"] = Field(
        "matrix", description="matrix: gyro noise across the vertical; scalar: in all directions, as in Corollary 1"
    )
    gain_rad_s: Rate | None = Field(None, description="gain l in full trust; none: from gyro and acceleration noise")

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if self.gain_rad_s is not None and self.acceleration_density is not None:
            raise ValueError("gain_rad_s and acceleration_density say the same thing: give one")
        return self


class Body(Section):
    """Axes of the track."""

    axes: Literal["auto", "imu", "vehicle"] = Field(
        "auto", description="auto: the IMU's, unless a mounting is given or odometry and gravity show the vehicle's"
    )


class Gate(Section):
    """Quality gates: exit code 3 where passed."""

    max_sigma_attitude_deg: Degrees | None = Field(None, description="largest attitude sigma, any axis; none: no gate")


class Time(Section):
    """Clocks and windows."""

    source: Literal["header", "log", "publish"] = Field("header", description="which stamp of a message counts")
    start_s: Seconds | None = Field(None, description="start of the window, since the start of the log")
    end_s: Seconds | None = Field(None, description="end of the window, since the start of the log")
    max_gap_s: PositiveSeconds = Field(0.5, description="an IMU hole longer than this and than 5 periods is a gap")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.end_s is not None and self.end_s <= (self.start_s or 0.0):
            raise ValueError(f"end_s = {self.end_s:g} is not after start_s = {self.start_s or 0.0:g}")
        return self


class Output(Section):
    """Files and pictures."""

    formats: Annotated[tuple[Literal["parquet", "csv", "tum", "mcap"], ...], BeforeValidator(_formats)] = Field(
        ("parquet",), description="formats of the track"
    )
    theme: Literal["light", "dark"] = Field("light", description="colours of the pages")


class Settings(Section):
    """All settings of attest; each table is optional in ``attest.toml``."""

    world: World = World()
    imu: Imu = Imu()
    sun: Sun = Sun()
    magnetometer: Magnetometer = Magnetometer()
    compass: Compass = Compass()
    orientation: Orientation = Orientation()
    odometry: Odometry = Odometry()
    gps: Gps = Gps()
    stops: Stops = Stops()
    smoothing: Smoothing = Smoothing()
    navigation: Navigation = Navigation()
    tilt_ekf: TiltEkf = TiltEkf()
    heading: Heading = Heading()
    vertical: Vertical = Vertical()
    body: Body = Body()
    gate: Gate = Gate()
    time: Time = Time()
    output: Output = Output()
    map: dict[Role, str] = Field({}, description="role -> channel; the same as the channel key of a role's own table")
