"""The one error that means: the user can mend this."""


class TaskliftError(ValueError):
    """A mistake in what the user gave: a file, an option, a declaration.

    The message says what was expected, what was found, where, and what to do. The command line prints it as
    one line and exits with code 2; it never becomes a traceback there.
    """
