"""What is said about a result: ``report.json``, the PNG pages and one self-contained HTML page."""

from .model import Report, TrackRow
from .pages import write_pages

__all__ = ["Report", "TrackRow", "write_pages"]
