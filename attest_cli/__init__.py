"""attest: the best attitude and position track that a recorded drive can give, with a sigma that holds.

The conventions, on one page
----------------------------
Frames
    ``n`` navigation (local level, z up, ENU), ``b`` body (forward, left, up), ``s`` a sensor.
    ``R_nb``, ``q_nb`` take body to navigation: ``v_n = R_nb @ v_b``; inner letters cancel.
    Vectors carry their frame last: ``gyro_b``, ``accel_b``, ``position_n``.
Quaternion
    Hamilton, active, unit, ``(w, x, y, z)``, continuous in sign along a track. In files the order is in the column
    names.
Error state
    ``R_nb = R_nb_hat @ Exp(dtheta_b)``, ``dbias = bias_true - bias_hat``, order ``[dtheta_b, dbias]``.
Sensors
    Gyro: ``gyro = rate + bias + noise``. Accelerometer: specific force, ``+g`` on the up axis at rest.
Units
    SI and radians inside. A name holds its unit where it leaves SI: ``stop_threshold_deg``. Noise is given as densities
    (``rad/s/sqrt(Hz)``), bias walk as ``rad/s^2/sqrt(Hz)``.
Time
    ``int64`` nanoseconds at the file boundary; inside ``t``, float64 seconds since the integer ``t0_ns``.
Arrays
    Time first: vectors ``(n, 3)``, scalars ``(n,)``, covariances ``(n, k, k)``.
Segments
    Numbered from 1 in time order: stops odd, motions even, also when a log starts in motion.
Angles written to files
    ``roll_deg, pitch_deg, yaw_deg`` about the fixed axes x, y, z (REP-103); yaw counts from east, counter-clockwise.
Sigma
    One standard deviation. Attitude sigmas are about the world's axes, so z is heading.
"""

__version__ = "0.1.0"
