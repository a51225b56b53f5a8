"""A motion that is pushed at random, as a state-space model: exact steps, Kalman filter, innovations."""
