"""The errors a user can meet. Each carries one clear sentence: what, where, what to do."""


class SysidTribError(ValueError):
    """Base of the package's errors; the command line ends with `exit_status`."""

    exit_status = 1


class UsageError(SysidTribError):
    """A name that does not exist: an option, command, force, column or file."""

    exit_status = 2


class LibraryError(SysidTribError):
    """A force library that is malformed, hostile or not finite."""


class RecordError(SysidTribError):
    """A file that cannot be read as a record, or a result that cannot be written."""


class DecayError(SysidTribError):
    """A record that cannot support the request: too short, growing, clipped, flat, noise."""


class SimulationError(SysidTribError):
    """A model whose motion cannot be computed: diverging or switching without end."""
