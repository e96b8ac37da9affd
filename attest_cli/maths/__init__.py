"""Arrays in, arrays out: rotations, preintegration, Kalman algebra, consistency. Knows nothing of logs or settings."""
