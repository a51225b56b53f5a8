"""Where simulation and measurement disagree, and which missing effect explains it."""
