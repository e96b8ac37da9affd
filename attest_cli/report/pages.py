"""The pages of a result folder: drawn first, then put in place together, and what is stale taken away."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from .. import figures
from ..errors import AttestError
from ..records import Result
from ..writers.files import atomic_write
from . import html
from .model import Report

FOLDER, HTML = "report", "report.html"
_PAGE = re.compile(r"\d\d-[a-z0-9-]+\.png")


def write_pages(
    result: Result, folder: Path, theme: str | None, progress: Callable[[str, float], None] | None = None
) -> list[dict[str, str]]:
    """Draw every page into ``folder/report`` and all of them into ``report.html``.

    Parameters
    ----------
    result : Result
        What the pages are drawn from.
    folder : Path
        The result folder.
    theme : str or None
        light or dark; None: as the result was drawn before.
    progress : callable, optional
        Told the stage and the share done.

    Returns
    -------
    list of dict
        file, title and alt text of each page, in order: ``pages`` of ``report.json``.

    Raises
    ------
    AttestError
        If the report is not of this shape, or the result names a page that would leave the folder.
    """
    drawn = _checked(result, folder)
    theme = theme or drawn
    pictures: list[html.Picture] = []
    for name, page in figures.pages(result, theme):
        if not _PAGE.fullmatch(name):
            raise AttestError(f"{folder}: {name!r} is no name of a page", "innovations.parquet names an unknown sensor")
        pictures.append(({"file": name, "title": page.title, "alt": page.alt}, page.png()))
        if progress is not None:
            progress("drawing pages", min(1.0, len(pictures) / 8))
    target = folder / FOLDER
    target.mkdir(exist_ok=True)
    contents: dict[str, Any] = {entry["file"]: png for entry, png in pictures}
    contents[HTML] = html.page(result, pictures).encode("utf-8")
    for name, data in contents.items():
        with atomic_write(target / name) as temporary:
            temporary.write_bytes(data)
    for old in target.iterdir():
        if _PAGE.fullmatch(old.name) and old.name not in contents:
            old.unlink()
    return [dict(entry) for entry, _ in pictures]


def _checked(result: Result, folder: Path) -> str:
    """Return the theme in which a report that is one was drawn before."""
    try:
        setting = Report.model_validate(result.report).settings.get("output.theme")
    except ValidationError as fault:
        first = fault.errors()[0]
        where = ".".join(map(str, first["loc"]))
        message = f"{folder / 'report.json'}: not a report of this version of attest: {where}: {first['msg'].lower()}"
        raise AttestError(message, "run attest smooth again") from None
    return "dark" if setting is not None and setting.value == "dark" else "light"
