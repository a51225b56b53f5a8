"""Free decays: half periods, equilibrium, release and stop, envelope."""
