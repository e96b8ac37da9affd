"""A result folder that appears whole or not at all; an older result stays whole until the new one is."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import AttestError
from .files import check_output

LAST, CALIBRATION = "report.json", "calibration.toml"
OURS = re.compile(r"(track\.(parquet|csv|tum|mcap)|passes\.parquet|innovations\.parquet|segments\.csv|report\.json"
                  r"|report/(\d\d-[a-z0-9-]+\.png|report\.html)"
                  r"|calibration\.toml|imu\.yaml|08-calibrate-bias\.png"
                  r"|evaluation\.json|09-evaluate\.png)")  # fmt: skip
MARK = b"attest_version"  # within the first bytes of the last file


@contextmanager
def result_folder(
    output: Path, *, overwrite: bool = False, inputs: Sequence[Path] = (), last: str = LAST
) -> Iterator[Path]:
    """Give a temporary folder beside ``output``; it takes the place of ``output`` when all went well.

    Messages from within name the wanted path, not the temporary one. With ``overwrite`` the files of an older result
    are replaced one by one, ``last`` last, those of a result that the new one does not have are removed, and files that
    are not ours stay.

    Raises
    ------
    AttestError
        If ``output`` exists and may not be replaced, or its place cannot be written to.
    """
    check_output(output, overwrite=overwrite, inputs=inputs)
    if output.exists() and not output.is_dir():
        raise AttestError(f"{output}: is a file, a result is a folder", "choose another name with -o")
    if not _replaceable(output, last):
        message = f"{output}: holds files, but no {last} of attest: not a result folder"
        raise AttestError(message, "choose another name with -o, or empty it")
    temporary = output.parent / f".{output.name[:100]}.{os.getpid()}.{secrets.token_hex(4)}.tmp"
    made = [folder for folder in output.parents if not folder.exists()]
    try:
        temporary.mkdir(parents=True)
        yield temporary
        check_output(output, overwrite=overwrite, inputs=inputs)  # another run may have been faster
        if output.exists():
            with _undisturbed(output):
                _replace(temporary, output, last)
        else:
            temporary.rename(output)
    except AttestError as fault:
        raise AttestError(fault.message.replace(str(temporary), str(output)), fault.hint) from None
    except OSError as error:
        raise AttestError(
            f"{output}: cannot be written: {error.strerror or error}", "is there room, and is it yours?"
        ) from None
    finally:  # an interrupt leaves nothing behind either
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):  # with a result in them they stay
            for folder in made:
                folder.rmdir()


@contextmanager
def _undisturbed(folder: Path) -> Iterator[None]:
    """Hold off signals and other runs, where the system can, so that a result is of one run alone."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    handle, signals = os.open(folder, os.O_RDONLY), {signal.SIGINT, signal.SIGTERM}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        with suppress(OSError):  # some file systems have no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _replaceable(folder: Path, last: str) -> bool:
    """Tell whether nothing of anybody else stands there: an empty folder, or a result."""
    if not folder.exists() or not any(folder.iterdir()):
        return True
    report = folder / last
    return report.is_file() and MARK in report.read_bytes()[:400]


def _replace(new: Path, old: Path, last: str) -> None:
    """Move the files of ``new`` over those of ``old``."""
    names = sorted((p.relative_to(new).as_posix() for p in new.rglob("*") if p.is_file()), key=lambda n: (n == last, n))
    for name in names:
        place = (old / name).parent
        if place != old and place.is_symlink():  # no link leads out of a result
            place.unlink()
        place.mkdir(exist_ok=True)
        (new / name).replace(old / name)
    for path in [p for p in old.rglob("*") if p.is_file()]:
        name = path.relative_to(old).as_posix()
        if OURS.fullmatch(name) and name not in names:
            path.unlink()
