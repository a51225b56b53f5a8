"""The one home of the noise: level, colour, steps of the sensor."""
