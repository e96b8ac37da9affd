"""Settings of single filters: the navigation smoother and the filters of the papers."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from .quantities import (
    AccelDensity,
    Acceleration,
    AngleDensity,
    Frequency,
    JerkDensity,
    PositiveSeconds,
    Rate,
    Ratio,
    Seconds,
    Section,
    Unit,
    Vector,
    as_lever,
    finite,
)


class Navigation(Section):
    """The navigation smoother: attitude, velocity, position and sensor errors together."""

    motion: Literal["auto", "handheld", "static", "rover", "vehicle", "drone"] = Field(
        "auto", description="weak bounds on speed and place where no sensor gives them; auto: from sensors and rates"
    )


class TiltEkf(Section):
    """The filter of Vaganay et al. 1993: roll and pitch from accelerometer and gyro angles."""

    lever_arm_m: Annotated[Vector, BeforeValidator(as_lever)] = Field(
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
    c1_deg_s: Annotated[float, finite, Unit("deg/s")] | None = Field(
        None, description="bias C1 (1 - exp(-t/T)) + C2 about the vertical, t since the start; none: a random walk"
    )
    c2_deg_s: Annotated[float, finite, Unit("deg/s")] | None = Field(None, description="see c1_deg_s")
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
