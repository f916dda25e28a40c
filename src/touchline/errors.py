"""Errors meant for people: what was wrong, where, and what to do. The command prints them without a traceback."""


class TouchlineError(Exception):
    """Something that a user can mend. Its text is a complete message."""

    exit_status = 1


class InputError(TouchlineError):
    """A bad argument, file or setting: the command ends with exit status 2."""

    exit_status = 2


class NoFitError(TouchlineError):
    """An observation that fits no pose: the command ends with exit status 1."""
