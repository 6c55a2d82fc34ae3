"""Errors that a user can act on.

Each message states what went wrong, where, and what to do next. The command line prints them as one line and exits
with code 1; any other exception is a defect of the program and keeps its traceback.
"""


class UncleError(Exception):
    """Base of every error that is meant to reach a person. Its text is one line."""

    def __str__(self) -> str:
        return one_line(super().__str__())


def one_line(text: str) -> str:
    """`text` with line ends and other control characters, which names of files can hold, written as escapes."""
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii") for letter in text
    )


class DataError(UncleError):
    """A recording, a mesh or a trajectory that cannot be used as it is."""


class RunError(UncleError):
    """A run directory that is missing, unwritable, incomplete or of another version."""


class ConfigError(UncleError):
    """A setting that does not exist or is out of its range."""


class DependencyError(UncleError):
    """A library or a system package that is missing; the message names the command that installs it."""


class FrameError(DataError):
    """One frame of a recording that cannot be read; the caller may report it and go on with the next."""
