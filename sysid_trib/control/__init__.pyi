from .linear_systems import damp as damp, linearise as linearise, to_nonlinear_system as to_nonlinear_system
