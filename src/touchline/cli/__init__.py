"""The `touchline` command. Its parts are imported in `main`, where a Ctrl-C ends them without a traceback."""

import atexit
import gc
import io
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress

INTERRUPTED = 130  # what a shell expects after Ctrl-C


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (default: that of the process). Returns the exit status.

    0: done. 1: the run failed. 2: bad arguments or input. 130: interrupted. Errors go to stderr in one message.
    """
    _open_output()
    if arguments is None:  # the command itself
        gc.set_threshold(100_000)  # what imports make stays, and looking through it takes 0.1 s on the way
        atexit.register(gc.freeze)  # and as long at the end
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends a command as Ctrl-C does
    # matrices and images are small: more threads would wait for each other
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("NUMBA_OPT", "1")  # compiled a tenth sooner than at 3, as fast, the same bits
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments) or ["--help"])
    except KeyboardInterrupt:  # before Typer takes over
        return _complain("interrupted", INTERRUPTED)


def _run(given: list[str]) -> int:
    import typer

    from touchline.cli.commands import CLICK_EXCEPTION, app
    from touchline.cli.console import DEBUG_VARIABLE
    from touchline.errors import TouchlineError

    try:
        status = typer.main.get_command(app).main(given, prog_name="touchline", standalone_mode=False)
        sys.stdout.flush()
    except TouchlineError as error:
        return _complain(str(error), error.exit_status)
    except CLICK_EXCEPTION as error:
        return _complain(_usage_message(error), 2)
    except typer.Abort:
        return _complain("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        _drop_output()
        return 0
    except SystemExit as ended:
        if not isinstance(ended.__context__, BrokenPipeError):  # which is what older releases of Typer make of it
            raise
        _drop_output()
        return 0
    except OSError as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        _drop_output()
        status = 2 if isinstance(error, PermissionError) and error.filename else 1  # a path that was given
        return _complain(f"{error.filename or 'the output'}: {error.strerror or error}", status)
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        from touchline.messages import unexpected

        return _complain(f"unexpected {unexpected(error)} (touchline --debug {' '.join(given)} shows the traceback)", 1)
    if status == INTERRUPTED:  # Typer's word for a Ctrl-C
        return _complain("interrupted", INTERRUPTED)
    return status if isinstance(status, int) else 0


def _open_output() -> None:
    """Where stdout or stderr were closed, nowhere; what their encoding lacks is written as \\xe4 instead of failing."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # its number must not become that of the next file that is opened
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))
        elif isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Send what stdout still holds nowhere, so that Python doesn't try again at its end."""
    with suppress(OSError, ValueError):  # a stdout that is no file needs nothing
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _usage_message(error: Exception) -> str:
    """One line of what is wrong with the arguments, and where to read on."""
    message = str(getattr(error, "format_message", lambda: error)()).strip() or "Missing command or argument"
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "touchline"
    return f"{message if message.endswith(('.', '?', '!')) else message + '.'} See {command} --help"


def _complain(message: str, status: int) -> int:
    from touchline.cli.console import complain

    complain(message)
    return status
