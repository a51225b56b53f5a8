"""The one home of the noise: the sensor's level, colour and steps; a random force in the motion."""
