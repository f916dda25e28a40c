"""The `touchline` command. Its parts are imported in `main`, where a Ctrl-C ends them without a traceback."""

import atexit
import gc
import io
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

INTERRUPTED = 130  # what a shell expects after Ctrl-C
_IMPORT = "<frozen importlib"  # begins the file name of the frames in which modules are imported
_AGAIN_S = 0.02


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (default: that of the process). Returns the exit status.

    0: done. 1: the run failed. 2: bad arguments or input. 130: interrupted. Errors go to stderr in one message.
    """
    _open_output()
    if arguments is None:  # the command itself
        gc.set_threshold(100_000)  # what imports make stays, and looking through it takes 0.1 s on the way
        atexit.register(gc.freeze)  # and as long at the end
    os.environ["MPLBACKEND"] = "agg"  # figures are written, not shown; Matplotlib refuses names that it does not know
    # matrices and images are small: more threads would wait for each other
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("NUMBA_OPT", "1")  # compiled a tenth sooner than at 3, as fast, the same bits
    with _interruptions() as interrupted:
        try:
            return _run(list(sys.argv[1:] if arguments is None else arguments) or ["--help"], interrupted)
        except KeyboardInterrupt:
            return _complain("interrupted", INTERRUPTED)


def _run(given: list[str], interrupted: Callable[[], bool]) -> int:
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
        if interrupted():  # a library made something else of it
            return _complain("interrupted", INTERRUPTED)
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


@contextmanager
def _interruptions() -> Iterator[Callable[[], bool]]:
    """Lets Ctrl-C and SIGTERM raise KeyboardInterrupt, and end the process while a command's imports go on.

    An exception in the middle of an import, or of a call back from LLVM, may be swallowed or shown with its traceback:
    there it waits. Yields whether there was one. A signal that is ignored stays so.
    """
    asked = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        if _starts_up(frame):
            with suppress(OSError, ValueError, RuntimeError):
                sys.stdout.flush()
            with suppress(OSError):
                os.write(2, b"error: interrupted\n")
            os._exit(INTERRUPTED)
        if hasattr(signal, "setitimer") and any(_may_swallow(one) for one in _stack(frame)):  # Windows has none
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        raise KeyboardInterrupt

    before = {}
    with suppress(ValueError):  # in another thread than the main one
        for kind in _signals():
            if signal.getsignal(kind) is not signal.SIG_IGN:
                before[kind] = signal.signal(kind, stop)
    try:
        yield lambda: asked
    finally:
        if asked and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _signals() -> list[int]:
    """What may end a command: Ctrl-C, a kind word, and the timer that asks again where there is one."""
    names = ("SIGINT", "SIGTERM", "SIGALRM")
    return [int(getattr(signal, name)) for name in names if hasattr(signal, name)]


def _starts_up(frame: FrameType | None) -> bool:
    """Whether an import goes on that no function of the library has begun, which may have something to clear up."""
    importing = False
    for one in _stack(frame):
        name = str(one.f_globals.get("__name__", ""))
        importing = importing or one.f_code.co_filename.startswith(_IMPORT)
        works = name.startswith("touchline.") and not name.startswith("touchline.cli")
        if importing and works and one.f_code.co_name != "<module>":
            return False
    return importing


def _may_swallow(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith(_IMPORT) or str(frame.f_globals.get("__name__")).startswith("llvmlite")


def _stack(frame: FrameType | None) -> Iterator[FrameType]:
    """The frames of a call, from the innermost outwards."""
    while frame is not None:
        yield frame
        frame = frame.f_back


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
