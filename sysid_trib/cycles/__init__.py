"""One cycle: describing functions, steady cycles, a decay by averaging, its backbone and indicated forces."""
