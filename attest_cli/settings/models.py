"""Every setting with its unit, its default and where that comes from. The config schema is generated from here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from .filters import Heading, Navigation, TiltEkf, Vertical
from .quantities import (
    AccelDensity,
    Acceleration,
    AccelWalk,
    Altitude,
    Angle,
    Degrees,
    GyroDensity,
    GyroWalk,
    Latitude,
    LeverArm,
    Longitude,
    Metres,
    PositiveSeconds,
    Quaternion,
    Rate,
    Ratio,
    Seconds,
    Section,
    Speed,
    Vector,
    as_direction,
    as_field,
    as_formats,
    as_passes,
    as_quaternion,
    positive,
)
from .table import Table

EARTH_GRAVITY_M_S2 = 9.80665  # standard gravity, 3rd CGPM 1901
MARS_GRAVITY_M_S2 = 3.72076  # mean surface gravity of Mars
GPS_SIGMA_M, POSITION_SIGMA_M = 3.0, 0.1  # of a fix where neither user nor log states one

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
    "gps_velocity",
    "position",
    "height",
    "temperature",
]


class World(Section):
    """The world: gravity, reference directions, the frame of the outputs."""

    frame: Literal["enu", "ned"] = Field("enu", description="axes of the outputs; REP-103: east, north, up")
    body: Literal["earth", "mars"] = Field("earth", description="where the drive was: gravity and the sun's path")
    gravity_m_s2: Acceleration = Field(EARTH_GRAVITY_M_S2, description='standard gravity; 3.72076 with body = "mars"')
    sun_direction: Annotated[Vector | None, BeforeValidator(as_direction)] = Field(
        None, description="direction to the sun (east, north, up); none: from latitude, longitude and the log's time"
    )
    latitude_deg: Latitude | None = Field(None, description="for sun and magnetic field; north positive")
    longitude_deg: Longitude | None = Field(None, description="for sun and magnetic field; east positive")
    altitude_m: Altitude = Field(0.0, description="height above the ellipsoid")
    magnetic_field_ut: Annotated[Vector | None, BeforeValidator(as_field)] = Field(
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
    mounting: Annotated[Quaternion | Literal["auto"], BeforeValidator(as_quaternion)] = Field(
        "auto", description="q body <- sensor (w, x, y, z); auto: the IMU's axes unless the log shows the vehicle's"
    )
    gyro_noise_density: GyroDensity | None = Field(None, description="noise of the rate; none: from the log's stops")
    gyro_random_walk: GyroWalk | None = Field(None, description="walk of the bias; none: from the log's stops")
    accel_noise_density: AccelDensity | None = Field(
        None, description="noise of the specific force; none: from the log's stops"
    )
    gyro_scale_sigma: Ratio | None = Field(
        None, description="scale and misalignment of the gyro, 1 sigma; none: 0.003, a factory-calibrated MEMS gyro"
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
    gyro_samples: Literal["auto", "point", "interval"] = Field(
        "auto",
        description="a gyro sample is the rate at its stamp (point: trapezoid) or the mean since the stamp before; "
        "auto: point, unless a magnetometer shows the other",
    )


class Sun(Section):
    """A sun sensor, or any sensor of one known direction."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_deg: Degrees = Field(0.5, description="noise per axis; the sun sensor of Roumeliotis et al. 1999")
    mounting: Annotated[Quaternion, BeforeValidator(as_quaternion)] = Field(
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
    sigma_m_s: Speed = Field(0.05, description="noise of the forward speed; not given: as the log states, else this")
    lateral_sigma_m_s: Speed = Field(0.05, description="slip sideways and up; not given: as the log states, else this")
    scale_sigma: Ratio = Field(0.03, description="scale error, 1 sigma; tyre pressure and load")
    lever_arm_m: LeverArm = Field(
        "auto",
        description="from the IMU to where the wheels' velocity holds, body axes; auto: as the drive shows, else 0",
    )


class Gps(Section):
    """Satellite positions and velocities."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_m: Metres | None = Field(None, description=f"noise per axis; none: the log's, else {GPS_SIGMA_M:g} m")
    velocity_sigma_m_s: Speed | None = Field(
        None, description="noise per axis of GPS velocity; none: as the log states, else 0.1 m/s"
    )
    lever_arm_m: LeverArm = Field(
        "auto", description="from the IMU to the antenna, body axes; auto: as the drive shows, else 0"
    )


class Position(Section):
    """Positions in local axes, east, north, up: a tracker, a total station."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_m: Metres | None = Field(None, description=f"noise per axis; none: the log's, else {POSITION_SIGMA_M:g} m")
    lever_arm_m: LeverArm = Field(
        "auto", description="from the IMU to the point that is tracked, body axes; auto: as the drive shows, else 0"
    )


class Height(Section):
    """Height from a barometer or an altimeter, counted from anywhere."""

    channel: str | None = Field(None, description="topic or column group; none: by type and name")
    sigma_m: Metres = Field(0.5, description="noise of one reading; a MEMS barometer")


class Stops(Section):
    """The stop detector, or stops given by hand."""

    file: Path | None = Field(
        None, description="CSV with start_s, end_s, relative to the config file: overrides the detector"
    )
    min_stop_s: Seconds = Field(2.0, description="shorter stops are motion; found on simulated drives")
    min_motion_s: Seconds = Field(0.5, description="shorter motions are part of the stop; found on simulated drives")
    window_s: PositiveSeconds = Field(1.0, description="window of the statistic; found on simulated drives")
    enter: Annotated[float, positive] | None = Field(
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
    ] = Field("auto", description="forward filter; auto: navigation with positions or in a hand, else indirect")
    smoother: Literal["two-filter", "rts", "paper", "none"] = Field(
        "two-filter",
        description="two-filter and rts: the same optimum; paper: the literal procedure; none: forward only",
    )
    iterations: Annotated[int | Literal["auto"], BeforeValidator(as_passes)] = Field(
        "auto",
        description="Gauss-Newton passes; auto: where a start in motion or far-off passes ask for them",
    )
    node_spacing_s: PositiveSeconds = Field(
        0.1,
        le=10.0,
        description="step between nodes; in long motions of long logs up to five times that, if not stated",
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
        "auto",
        description="auto: the filter's own, else odometry, else strapdown; literal: Roumeliotis et al. 1999",
    )


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

    formats: Annotated[tuple[Literal["parquet", "csv", "tum", "mcap"], ...], BeforeValidator(as_formats)] = Field(
        ("parquet",), description="formats of the track"
    )
    theme: Literal["light", "dark"] = Field("light", description="colours of the pages")


class Settings(Section):
    """All settings of attest; each table is optional in ``attest.toml``."""

    world: World = World.model_construct()
    imu: Imu = Imu.model_construct()
    sun: Sun = Sun.model_construct()
    magnetometer: Magnetometer = Magnetometer.model_construct()
    compass: Compass = Compass.model_construct()
    orientation: Orientation = Orientation.model_construct()
    odometry: Odometry = Odometry.model_construct()
    gps: Gps = Gps.model_construct()
    position: Position = Position.model_construct()
    height: Height = Height.model_construct()
    stops: Stops = Stops.model_construct()
    smoothing: Smoothing = Smoothing.model_construct()
    navigation: Navigation = Navigation.model_construct()
    tilt_ekf: TiltEkf = TiltEkf.model_construct()
    heading: Heading = Heading.model_construct()
    vertical: Vertical = Vertical.model_construct()
    body: Body = Body.model_construct()
    gate: Gate = Gate.model_construct()
    time: Time = Time.model_construct()
    table: Table = Table.model_construct()
    output: Output = Output.model_construct()
    map: dict[Role, str] = Field({}, description="role -> channel; the same as the channel key of a role's own table")
