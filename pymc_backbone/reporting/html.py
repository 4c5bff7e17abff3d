"""Pieces of an HTML page: escaped text, tables, numbers, images inside the file, and the style sheet."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Mapping, Sequence
from urllib.parse import quote

import numpy as np
from matplotlib.figure import Figure

from .._common.text import likewise
from .pictures import png

MOST_RECORDS = 12  # that are told of in the open

STYLE = """\
:root{--page:#f3f5f7;--card:#fff;--ink:#1a2330;--soft:#5a6675;--line:#dde3ea;--tone:#0b5cad;--wash:#e8f1fb;--mark:#f7f9fb}
.adequate{--tone:#0a7048;--wash:#e5f4ed}.found{--tone:#0b5cad;--wash:#e8f1fb}
.ambiguous{--tone:#8a5300;--wash:#fbf1e0}.unexplained{--tone:#a32632;--wash:#fbe9ea}
@media(prefers-color-scheme:dark){
:root{--page:#11161d;--card:#1a222c;--ink:#e6ebf1;--soft:#a0adbb;--line:#303b48;--mark:#202a35;--tone:#6db3f8;--wash:#15293f}
.adequate{--tone:#5fd0a0;--wash:#12301f}.found{--tone:#6db3f8;--wash:#15293f}
.ambiguous{--tone:#efb45a;--wash:#33260f}.unexplained{--tone:#f58d95;--wash:#3a1a1e}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);-webkit-text-size-adjust:100%;
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans","DejaVu Sans",sans-serif}
main{max-width:1120px;margin:0 auto;padding:20px 16px 48px}
header,section{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:20px 22px;margin:0 0 16px}
header{border-top:6px solid var(--tone);background:linear-gradient(var(--wash),var(--card))}
.word{display:inline-block;background:var(--tone);color:var(--card);font-weight:700;font-size:.82rem;letter-spacing:.06em;
text-transform:uppercase;border-radius:999px;padding:3px 14px}
.word.small{font-size:.72rem;padding:1px 9px;white-space:nowrap}
a{color:var(--tone);overflow-wrap:anywhere}
.kicker{color:var(--soft);font-size:.85rem;margin-left:8px}
h1{font-size:1.55rem;line-height:1.28;margin:12px 0 8px;font-weight:650;overflow-wrap:anywhere}
h1.long{font-size:1.24rem}
h2{font-size:1.12rem;margin:0 0 10px;font-weight:650}
h3{font-size:.95rem;margin:18px 0 6px;font-weight:650}
p{margin:.45em 0;overflow-wrap:anywhere}.soft{color:var(--soft);font-size:.9rem}
ul{margin:.4em 0;padding-left:1.25em}li{margin:.25em 0;overflow-wrap:anywhere}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:10px;margin:16px 0 0}
.tile{background:var(--card);border:1px solid var(--line);border-radius:9px;padding:10px 12px}
.tile b{display:block;font-size:1.12rem;line-height:1.25;
font-weight:650;font-variant-numeric:tabular-nums}
.tile span{display:block;color:var(--soft);font-size:.8rem;line-height:1.35}
.pair{display:grid;margin:0 0 12px;grid-template-columns:repeat(2,minmax(0,1fr));gap:14px;align-items:start}
figure{margin:0 0 4px}figure img{display:block;width:100%;max-width:640px;height:auto;background:#fff;border-radius:8px;
border:1px solid var(--line)}figure.wide img{max-width:100%}
figcaption{color:var(--soft);font-size:.84rem;margin:5px 0 8px}
table{border-collapse:collapse;width:100%;font-size:.9rem;font-variant-numeric:tabular-nums}
th{text-align:left;font-weight:600;color:var(--soft);font-size:.8rem;border-bottom:2px solid var(--line);
padding:5px 14px 5px 0;vertical-align:bottom}
td{border-bottom:1px solid var(--line);padding:6px 14px 6px 0;vertical-align:top;overflow-wrap:break-word}
.bar{display:inline-block;min-width:84px;padding:0 5px;border-radius:4px;border:1px solid var(--line);
background:linear-gradient(90deg,color-mix(in srgb,var(--tone) 30%,transparent) var(--p),transparent var(--p))}
.n{text-align:right;white-space:nowrap}.u{white-space:nowrap}tr.strong td{background:var(--wash);font-weight:600}
tr.strong td:first-child{box-shadow:-6px 0 0 var(--wash)}
pre{background:var(--mark);border:1px solid var(--line);border-radius:8px;padding:10px 12px;margin:6px 0;
white-space:pre-wrap;overflow-wrap:anywhere;
font:.84rem/1.5 ui-monospace,"SF Mono",Menlo,Consolas,"Liberation Mono","DejaVu Sans Mono",monospace}
code{font-family:ui-monospace,Menlo,Consolas,"Liberation Mono","DejaVu Sans Mono",monospace;font-size:.88em}
pre b{color:var(--tone)}sup{font-size:.7em;line-height:0}
details{margin:8px 0}td details{margin:0}
td summary{padding:0}
summary{cursor:pointer;color:var(--tone);font-weight:600;font-size:.92rem;padding:4px 0}
.good{color:#0a7048;font-weight:600}.bad{color:#a32632;font-weight:600}
@media(prefers-color-scheme:dark){.good{color:#5fd0a0}.bad{color:#f58d95}}
footer{color:var(--soft);font-size:.82rem;padding:4px 6px}
@media(max-width:720px){main{padding:10px 8px 32px}header,section{padding:15px 14px;border-radius:10px}
h1{font-size:1.26rem}h1.long{font-size:1.06rem}
.pair{grid-template-columns:minmax(0,1fr)}.tiles{grid-template-columns:repeat(2,minmax(0,1fr))}
.stack thead{display:none}.stack,.stack tbody,.stack td{display:block}.stack tr{display:grid;
grid-template-columns:repeat(2,minmax(0,1fr));column-gap:22px;border:1px solid var(--line);
border-radius:9px;padding:7px 11px;margin:0 0 9px}.stack tr.strong{background:var(--wash)}
.stack td{border:0;padding:2px 0;grid-column:span 2;
display:flex;justify-content:space-between;gap:10px;text-align:right;white-space:normal}.stack td.n{grid-column:span 1}
.stack td::before{content:attr(data-label);color:var(--soft);font-weight:400;text-align:left;flex:none}
.stack td>span{min-width:0;overflow-wrap:anywhere}
.stack td .bar{min-width:64px}.stack td.text span,.stack td.head span{text-align:left}
.stack td.head{font-weight:650;text-align:left}.stack td.head::before,.stack td.text::before{content:none}
.stack td.text{text-align:left;color:var(--soft)}.stack tr.strong td:first-child{box-shadow:none}}
@media(max-width:480px){.stack td.n{grid-column:span 2}}
@media print{body{background:#fff;font-size:11pt}main{max-width:none;padding:0}header,section{border:0;padding:0 0 8px;
margin:0 0 12px}figure,tr,pre,.tile,.pair{break-inside:avoid}table{font-size:.78rem}
figure img{max-width:430px}h2,h3{break-after:avoid}}
"""


_TYPESET = (
    (r"(?<=\d)%(?!\w)", " %"),
    (r"\bmicrometres\b", "&micro;m"),
    (r"\bnanometres\b", "nm"),
    (r"(?<=[ (])-(?=\d)", "&minus;"),
    (r"(?<![\w.])(\d+(?:\.\d+)?)e\+?(-?)0*(\d+)(?!\.?\w)", r"\1&thinsp;&times;&thinsp;10<sup>\2\3</sup>"),
    (r"<sup>-", "<sup>&minus;"),
    (r"\^\(([^()]*)\)", r"<sup>\1</sup>"),
    (r"`([^`]+)`", r"<code>\1</code>"),
)
"""What sentences for a terminal, in ASCII, are on a page: patterns and what stands for them, in this order."""


class Raw(str):
    """Text that is HTML already."""


def escape(value: object) -> str:
    """Return text for an HTML page: escaped, control characters made visible; HTML stays as it is."""
    if isinstance(value, Raw):
        return value
    text = "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in str(value))
    return html.escape(text)


def prose(text: object) -> Raw:
    """Return a sentence as it is typeset: escaped, with raised powers, signs, and units that stay with their numbers.

    Examples
    --------
    >>> prose("A^(1.96 +- 0.02), 44% off (p = 4e-34), -0.3 Hz at 3 micrometres")
    'A<sup>1.96 &plusmn; 0.02</sup>, 44&nbsp;% off (p = 4&thinsp;&times;&thinsp;10<sup>&minus;34</sup>), \
&minus;0.3 Hz at 3 &micro;m'
    """
    said = escape(text)
    if not isinstance(text, Raw):
        for pattern, typeset in _TYPESET:
            said = re.sub(pattern, typeset, said)
    return Raw(said.replace(" %", "&nbsp;%").replace("+-", "&plusmn;"))


def number(value: float, digits: int = 4) -> Raw:
    """Return a number with so many significant digits, powers of ten as such."""
    if value is None or not np.isfinite(value):
        return Raw("&ndash;")
    size = int(np.floor(np.log10(abs(value)))) if value else 0
    if -4 < size < 6:
        rounded = round(float(value), digits - 1 - size)
        text = f"{rounded:.{max(digits - 1 - size, 0)}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        text = f"{value:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa.replace("-", "&minus;")
    if not exponent:
        return Raw(mantissa)
    return Raw(f"{mantissa}&thinsp;&times;&thinsp;10<sup>{str(int(exponent)).replace('-', '&minus;')}</sup>")


def unit(text: str) -> Raw:
    """Return a unit with its powers raised; a dimensionless one is a dash."""
    if text in ("1", "", "-"):
        return Raw("&ndash;")
    pieces = escape(text).split("^")
    result = pieces[0]
    for piece in pieces[1:]:
        end = next((i for i, c in enumerate(piece) if not (c.isalnum() or c == "-")), len(piece))
        result += f"<sup>{piece[:end].replace('-', '&minus;')}</sup>{piece[end:]}"
    return Raw(f'<span class="u">{result}</span>')


def link(text: object, path: str) -> Raw:
    """Return a link to a file below the page's folder."""
    return Raw(f'<a href="{escape(quote("./" + path))}">{escape(text)}</a>')


def paragraph(text: object, kind: str = "") -> str:
    """Return a paragraph."""
    return f"<p{_kind(kind)}>{prose(text)}</p>"


def bullets(sentences: Iterable[object]) -> str:
    """Return a list of sentences, or nothing if there are none."""
    items = "".join(f"<li>{prose(sentence)}</li>" for sentence in sentences)
    return f"<ul>{items}</ul>" if items else ""


def noted(notes: Sequence[str], names: Sequence[str] = ()) -> str:
    """Return what was assumed or done: one line for each record, warnings first; what is about no record is folded.

    Parameters
    ----------
    notes : sequence of str
        Sentences; what is about one record begins with its name and a colon.
    names : sequence of str
        The records. Of many, those behind the first are folded away.
    """
    loud = [note for note in notes if "warning: " in note or note.startswith(("left out: ", "alike: "))]
    own: dict[str, list[str]] = {name: [] for name in names}
    others = []
    for note in notes:
        name, colon, said = note.partition(": ")
        if note in loud:
            continue
        if colon and name in own:
            own[name].append(said)
        else:
            others.append(note)
    columns = (("record", "head"), ("what was cut, subtracted or assumed", "text"))
    rows = _by_record(own)
    more = f"{len(rows) - MOST_RECORDS} more records"
    folded = details(f"Other notes ({len(others)})", bullets(others), is_open=0 < len(others) <= 5)
    return (
        (f"<h3>Look at these records</h3>{bullets(likewise(loud))}" if loud else "")
        + table(columns, rows[:MOST_RECORDS])
        + details(more, table(columns, rows[MOST_RECORDS:]))
        + folded
    )


def _by_record(own: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Return a row for what is true of all records, then one for each of which more is to be said."""
    common = [said for said in next(iter(own.values()), ()) if all(said in every for every in own.values())]
    common = common if len(own) > 1 else []
    rows = [(f"all {len(own)}", "; ".join(common))] if common else []
    for name, every in own.items():
        said = "; ".join(one for one in every if one not in common)
        rows += [(name, said)] if said else []
    return rows


def tiles(pairs: Sequence[tuple[object, object]]) -> str:
    """Return key figures: value and what it is."""
    inside = "".join(f'<div class="tile"><b>{escape(a)}</b><span>{escape(b)}</span></div>' for a, b in pairs)
    return f'<div class="tiles">{inside}</div>'


def section(title: str, *parts: str) -> str:
    """Return a section with what it holds, or nothing if that is empty."""
    inside = "\n".join(part for part in parts if part)
    return f"<section>\n<h2>{escape(title)}</h2>\n{inside}\n</section>\n" if inside else ""


def details(title: object, *parts: str, is_open: bool = False) -> str:
    """Return what can be folded away, or nothing if that is empty."""
    inside = "\n".join(part for part in parts if part)
    return (
        f"<details{' open' if is_open else ''}><summary>{escape(title)}</summary>\n{inside}\n</details>"
        if inside
        else ""
    )


def table(columns: Sequence[tuple[str, str]], rows: Sequence[Sequence[object]], *, strong: Iterable[int] = ()) -> str:
    """Return a table that becomes a stack of cards on a phone, or nothing if it has no rows.

    Parameters
    ----------
    columns : sequence of (str, str)
        Heading and kind: ``head`` (what the row is about), ``n`` (a short number), ``text`` (a sentence) or nothing.
    rows : sequence of sequence
        Cells.
    strong : iterable of int
        Rows to stress.
    """
    if not rows:
        return ""
    stressed = set(strong)
    head = "".join(f"<th{_kind(kind)}>{escape(title)}</th>" for title, kind in columns)
    body = []
    for i, row in enumerate(rows):
        cells = "".join(
            f'<td{_kind(kind)} data-label="{escape(title)}"><span>{_cell(cell, kind)}</span></td>'
            for (title, kind), cell in zip(columns, row, strict=True)
        )
        body.append(f"<tr{_kind('strong' if i in stressed else '')}>{cells}</tr>")
    lines = "\n".join(body)
    return f'<table class="stack"><thead><tr>{head}</tr></thead>\n<tbody>\n{lines}\n</tbody></table>'


def _cell(cell: object, kind: str) -> Raw | str:
    return prose(cell) if kind == "text" else escape(cell)


def image(figure: Figure | None, text: str, *, is_wide: bool = False, caption: str = "") -> str:
    """Return a figure inside the page, or nothing if there is none."""
    if figure is None:
        return ""
    data = base64.b64encode(png(figure)).decode("ascii")
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure{_kind("wide" if is_wide else "")}><img alt="{escape(text)}" src="data:image/png;base64,{data}">'
        f"{below}</figure>"
    )


def page(title: str, kind: str, body: str) -> str:
    """Return the whole document."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}</style>\n</head>\n"
        f'<body class="{escape(kind)}">\n<main>\n{body}</main>\n</body>\n</html>\n'
    )


def _kind(name: str) -> str:
    return f' class="{name}"' if name else ""
