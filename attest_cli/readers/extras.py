"""Packages of the extras: brought in on use, and one line that says what to install where one is absent."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from ..errors import AttestError


def extra(path: Path, module: str, name: str, what: str, package: str = "") -> Any:
    """Return a module of an extra.

    Parameters
    ----------
    module : str
        Such as ``rosbags.rosbag1``.
    name : str
        Of the extra.
    what : str
        What the file holds that needs it.
    package : str
        Its name in the registry, where that is another than the module's.

    Raises
    ------
    AttestError
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        needed = package or module.partition(".")[0]
        message = f"{path}: {what} is read with the package {needed}, which is not installed"
        raise AttestError(message, f"pip install 'attest-cli[{name}]'") from None
