"""The one error that means: the user can mend this."""

from tasklift.text import one_line


class TaskliftError(ValueError):
    """A mistake in what the user gave: a file, an option, a declaration.

    The message says what was expected, what was found, where, and what to do. It is one line of at most 300
    characters without control characters, whatever was found. The command line prints it and exits with code
    2; it never becomes a traceback there.
    """

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))
