"""What follows from an identification by physics alone: weights, crossovers, energies, SI units, slip."""
