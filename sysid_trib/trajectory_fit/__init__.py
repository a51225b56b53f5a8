"""The motion fitted to the record: problem, sensitivities, least squares, Cramer-Rao bound."""
