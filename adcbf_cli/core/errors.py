"""The errors a user may meet, and the exit code that each one means.

Anything raised from this module becomes one line on stderr; anything else is a bug and keeps
its traceback. The text says what is wrong, where, and what to do next.
"""

from collections.abc import Iterator
from contextlib import contextmanager

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_DATA_LOST = 3
EXIT_THRESHOLD = 4


class AdcbfError(Exception):
    """The work could not be done: a bad file, missing data, a failed write (exit code 1)."""

    exit_code = EXIT_FAILED


class UsageError(AdcbfError):
    """What was asked cannot be meant: a bad option, key, name or ambiguity (exit code 2)."""

    exit_code = EXIT_USAGE


@contextmanager
def given_by_option(prefix: str = "") -> Iterator[None]:
    """Within, what is wrong with a file is wrong usage: an option named it, and it is not what that option takes."""
    try:
        yield
    except AdcbfError as error:
        raise UsageError(f"{prefix}{error}") from None
