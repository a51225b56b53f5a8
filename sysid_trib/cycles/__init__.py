"""One cycle: describing functions, steady cycles, a decay by averaging, its backbone, what it points to."""
