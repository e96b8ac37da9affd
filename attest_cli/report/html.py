"""One self-contained page: the pictures inside, light or dark by the reader's choice, no script, nothing fetched."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..figures import style
from ..figures.drive import Drive, real
from ..figures.overview import key_numbers
from ..figures.words import clean, clock, date, duration, number, two_digits
from ..records import Result

Picture = tuple[Mapping[str, str], bytes]  # page entry and its PNG
MARKS = {"PASS": "●", "WARN": "▲", "FAIL": "✖"}

_CSS = """
:root{color-scheme:light dark;%(light)s}
@media(prefers-color-scheme:dark){:root{%(dark)s}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2.5rem 1.5rem 4rem;max-width:62rem;background:var(--paper);color:var(--text);
font:400 16px/1.5 "Source Sans 3","Source Sans Pro",system-ui,sans-serif;font-variant-numeric:tabular-nums}
h1{font-size:1.6rem;line-height:1.25;margin:0;display:flex;gap:.7rem;align-items:baseline;justify-content:space-between}
h1>span{white-space:nowrap;font-size:1.2rem}
h2{font-size:1.15rem;margin:2.6rem 0 .8rem}
p,li,td,th,summary{overflow-wrap:anywhere}
.mute,th,dd,footer{color:var(--mute)}
.pass{color:var(--pass)}.warn{color:var(--warn)}.fail{color:var(--fail)}
dl{display:flex;flex-wrap:wrap;gap:1rem 2rem;margin:1.6rem 0 0}
dt{font-size:1.55rem;font-weight:600;line-height:1.2}dd{margin:0;font-size:.85rem}
ul{list-style:none;margin:0;padding:0;display:grid;
grid-template-columns:repeat(auto-fit,minmax(19rem,1fr));gap:.9rem 2rem}
li{padding-left:1.5rem;position:relative}li>span{position:absolute;left:0}li small{display:block;color:var(--mute)}
figure{margin:0 0 1.6rem}img{display:block;width:100%%;height:auto;border-radius:6px}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%%;font-size:.9rem}
th{font-weight:400;text-align:left}td,th{padding:.28rem .9rem .28rem 0;
border-bottom:1px solid var(--grid);vertical-align:top}
td.n,th.n{text-align:right;white-space:nowrap}tr.stop td{background:var(--stop)}
summary{cursor:pointer;font-weight:600;margin:1.4rem 0 .6rem}footer{margin-top:3rem;font-size:.85rem}
@media print{body{max-width:none;padding:0}figure{break-inside:avoid}}
"""


def page(result: Result, pictures: Sequence[Picture]) -> str:
    """The whole page of a result; ``pictures`` in the order in which they are shown."""
    report = result.report
    title = pictures[0][0]["title"] if pictures else clean(result.folder.name)
    parts = [
        _head(report, title),
        _pairs(
            "dl",
            (f"<div><dt>{_h(value)}</dt><dd>{_h(words)}</dd></div>" for value, words, _ in key_numbers(Drive(result))),
        ),
        _notes("What to know", ((c["status"], c["fact"], c["detail"]) for c in report["checks"])),
        _notes(
            "Warnings",
            (("FAIL" if w["lost"] or w.get("fatal") else "WARN", w["message"], w["hint"]) for w in report["warnings"]),
        ),
        _notes("When to stop", (("PASS", line, "") for line in (report.get("advice") or {}).get("lines", ()))),
        *map(_figure, pictures),
        _segments(result.segments),
        _shown(report.get("shown") or []),
        _settings(report["settings"]),
        _footer(report),
    ]
    css = _CSS % {name: ";".join(f"--{k}:{v}" for k, v in style.THEMES[name].items()) for name in ("light", "dark")}
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{_h(title)}</title><style>{css}</style><body>{''.join(parts)}</body></html>\n"
    )


def _h(text: object, longest: int = 400) -> str:
    """Text safe in HTML: no hidden characters, no markup."""
    return html.escape(clean(text, longest))


def _head(report: Mapping[str, Any], title: str) -> str:
    verdict, given = report["verdict"], report["input"]
    names = ", ".join(file["name"] for file in given["files"])
    samples = f"{number(given['samples'])} samples"
    line = [names, date(given["start_utc"]), duration(given["duration_s"]), samples, *given["sensors"]]
    mark = f'<span class="{verdict.lower()}">{MARKS[verdict]} {verdict}</span>'
    return f'<h1>{_h(title)}{mark}</h1><p class="mute">{" · ".join(_h(part) for part in line if part)}</p>'


def _pairs(tag: str, items: Iterable[str]) -> str:
    return f"<{tag}>{''.join(items)}</{tag}>"


def _notes(title: str, lines: Iterable[tuple[str, str, str]]) -> str:
    """A list of facts, each with its mark and one muted line; nothing where there is none."""
    items = [
        f'<li><span class="{status.lower()}">{MARKS[status]}</span>{_h(fact)}<small>{_h(detail)}</small></li>'
        for status, fact, detail in lines
    ]
    return f"<h2>{title}</h2>{_pairs('ul', items)}" if items else ""


def _figure(picture: Picture) -> str:
    entry, png = picture
    data = base64.b64encode(png).decode("ascii")
    return f'<figure><img alt="{_h(entry["alt"], 2000)}" src="data:image/png;base64,{data}"></figure>'


def _segments(rows: Sequence[Mapping[str, Any]]) -> str:
    head = ("index", "kind", "start", "duration", "σ forward", "σ smoothed", "checks")
    body = []
    for row in rows:
        sigmas = (real(row.get(f"sigma_attitude_{p}_deg")) for p in ("forward", "smoothed"))
        numbers = [row["index"], row["kind"], clock(real(row["start_s"])), duration(real(row["duration_s"]))]
        cells = [*numbers, *(f"{two_digits(s)}°" if math.isfinite(s) else "" for s in sigmas), row.get("checks") or ""]
        body.append(f'<tr class="{"stop" if row["kind"] == "stop" else "motion"}">{_cells("td", cells)}</tr>')
    return f"<h2>Segments</h2>{_table(_cells('th', head), body)}" if body else ""


def _cells(tag: str, cells: Sequence[object]) -> str:
    """Cells of the table of segments: all but kind and checks are numbers."""
    return "".join(f'<{tag} class="{"" if k in {1, 6} else "n"}">{_h(cell)}</{tag}>' for k, cell in enumerate(cells))


def _table(head: str, body: Sequence[str]) -> str:
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'


def _shown(found: Sequence[Mapping[str, Any]]) -> str:
    """What the drive shows of its sensors, folded."""
    if not found:
        return ""
    rows = []
    for item in found:
        known = (["–" if v is None else two_digits(v) for v in item[key]] for key in ("values", "sigma"))
        values, sigma = (", ".join(column) for column in known)
        rows.append(
            f"<tr><td>{_h(item['name'])}</td><td>{_h(values)}</td><td>{_h(sigma)}</td><td>{_h(item['unit'])}</td></tr>"
        )
    head = "<th>of the sensors</th><th>value</th><th>sigma</th><th>unit</th>"
    return f"<details><summary>What the drive shows</summary>{_table(head, rows)}</details>"


def _settings(settings: Mapping[str, Mapping[str, Any]]) -> str:
    """All settings, folded; those that are no default first."""
    ordered = sorted(settings.items(), key=lambda item: item[1]["source"] == "default")
    rows = [
        f"<tr><td>{_h(name)}</td><td>{_h('' if s['value'] is None else s['value'])}</td><td>{_h(s['source'])}</td></tr>"
        for name, s in ordered
    ]
    head = "<th>setting</th><th>value</th><th>from</th>"
    return f"<details><summary>Settings</summary>{_table(head, rows)}</details>"


def _footer(report: Mapping[str, Any]) -> str:
    """What was run on what; no time of writing, so that two runs give the same page."""
    files = "".join(f"<br>{_h(f['name'])} · sha256 {_h(f['sha256'], 64)}" for f in report["input"]["files"])
    return f"<footer>attest {_h(report['attest_version'])}{files}</footer>"
