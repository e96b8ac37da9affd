"""``python -m attest_cli`` and the ``attest`` command: run it, and turn every end into one line and an exit code."""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

from .errors import AttestError, UsageError

REFUSED, USAGE = 1, 2
RETRY_S = 0.01  # after a signal that came while a library was loaded


class Stopped(BaseException):
    """A signal asked us to stop; no ``except Exception`` on the way may swallow it."""

    def __init__(self, number: int) -> None:
        self.exit_code = 128 + number
        super().__init__(f"signal {number}")


def main() -> None:
    """Run attest with the arguments of the process and leave with its exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # 6 x 6 blocks: a second BLAS thread only spins
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # else each start reads the metadata of all packages
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # what a user should know is said by attest itself
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a terminal without sigma shows its code, and no traceback
    try:
        code = run(sys.argv[1:] or ["--help"])
        _ignore_signals()  # the work is done: leave with its code
    except Stopped as stop:
        code = stop.exit_code
    _leave(code)


def run(arguments: Sequence[str]) -> int:
    """Exit code of one command line. Every fault is one plain line on stderr; ``-v`` adds the traceback of a defect."""
    try:
        return _finish(_invoke(arguments))
    except Stopped as stop:
        _line("stopped")
        return stop.exit_code
    except AttestError as fault:
        _line(str(fault))
        return USAGE if isinstance(fault, UsageError) else REFUSED
    except BrokenPipeError:
        _finish(REFUSED)
    except MemoryError:
        _line("not enough memory; read a part of the log with --start and --end")
    except OSError as fault:
        full = "standard output" if fault.errno == errno.ENOSPC else None  # files are named where they are written
        place = fault.filename if fault.filename is not None else full
        _line(str(fault) if place is None else f"{place}: {fault.strerror}")
    except Exception as fault:  # noqa: BLE001 (the last line of defence: a user never sees a bare traceback)
        _defect(
            fault, verbose=any(a == "--verbose" or (a[:1] == "-" and a[1:2] != "-" and "v" in a) for a in arguments)
        )
    return REFUSED


def _invoke(arguments: Sequence[str]) -> int:
    import typer

    from .app import app

    try:
        code = app(args=list(arguments), prog_name="attest", standalone_mode=False)
    except typer.TyperException as fault:
        command = getattr(getattr(fault, "ctx", None), "command_path", "attest")
        message = fault.format_message().replace("Value error, ", "").rstrip(".")
        _line(f"{message}; see {command} --help")
        return USAGE
    return code if isinstance(code, int) else 0


def _finish(code: int) -> int:
    """Flush what was printed; a reader that has left (``| head -1``) is no fault, a full disk is."""
    from .commands.console import named

    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                with named(stream):
                    stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # so that Python's own flush at exit is quiet
    return code


def _leave(code: int) -> NoReturn:
    """End the process here: to take down what the libraries have built, object by object, takes 0.15 s of every run."""
    with contextlib.suppress(OSError, AttestError):
        _finish(code)
    if sys.getprofile() is not None or sys.gettrace() is not None:
        sys.exit(code)  # a profiler tells what it saw after the ordinary end
    atexit._run_exitfuncs()  # noqa: SLF001 (some libraries clear up temporary folders there)
    os._exit(code)


def _line(text: str) -> None:
    from .commands.console import plain

    try:
        print(f"attest: {plain(text)}", file=sys.stderr, flush=True)  # noqa: T201
    except OSError:
        with contextlib.suppress(AttestError):
            _finish(REFUSED)


def _defect(fault: Exception, *, verbose: bool) -> None:
    if verbose:
        import traceback

        print(*map(_escaped, traceback.format_exception(fault)), sep="", end="", file=sys.stderr)  # noqa: T201
    hint = "please report it with the traceback above" if verbose else "run it again with -v for the traceback"
    _line(f"defect in attest: {type(fault).__name__}: {fault}; {hint}")


def _escaped(block: str) -> str:
    from .commands.console import plain

    return "".join(f"{plain(line)}\n" for line in block.splitlines())


def _stop(number: int, frame: FrameType | None) -> None:
    _ignore_signals()  # one is enough: clearing up must not be cut short
    if _importing(frame) and hasattr(signal, "setitimer"):  # a library that is cut off while it loads may abort
        signal.signal(signal.SIGALRM, lambda _, later: _stop(number, later))
        signal.setitimer(signal.ITIMER_REAL, RETRY_S)
    else:
        raise Stopped(number)


def _ignore_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


if __name__ == "__main__":
    main()
