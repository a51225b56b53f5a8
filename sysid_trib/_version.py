"""Version of the package, used by results and by the command line."""

__version__ = "0.1.0"
