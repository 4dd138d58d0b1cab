"""Hold a page as a title, lines, cards, tables and figures, and write it as self-contained HTML.

Nothing is loaded from anywhere: no script, no font, no picture. Every text goes through `html.escape`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import ClassVar
from urllib.parse import quote

from .numbers import figure

_STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#5b6570;--page:#fff;--card:#f4f6f8;--rule:#dde2e7;--grid:#e6e6e6;
--seen:#a6a6a6;--model:#0072b2;--good:#00734f;--open:#9a5b00}
@media(prefers-color-scheme:dark){:root{--ink:#e8eaed;--soft:#a3acb5;--page:#15181c;--card:#1f2429;--rule:#343b42;
--grid:#33393f;--seen:#8b8f94;--model:#56b4e9;--good:#4cc79b;--open:#f0b04c}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1.1rem 1rem 3rem;max-width:72rem;background:var(--page);color:var(--ink);
overflow-wrap:break-word;font:16px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
h1{font-size:1.75rem;line-height:1.2;margin:.1rem 0 .3rem}
h2{font-size:1.2rem;margin:2.2rem 0 .5rem}
h3{font-size:.8rem;text-transform:uppercase;letter-spacing:.07em;color:var(--soft);margin:0 0 .3rem}
p{margin:.35rem 0;max-width:46rem}
a{color:var(--model)}
h1+p{font-size:1.08rem}
.soft,figcaption{color:var(--soft)}
.good{color:var(--good)}.open{color:var(--open)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(17rem,1fr));gap:.8rem;margin:1rem 0}
.card{background:var(--card);border-radius:.6rem;padding:.8rem 1rem}
.big{font-size:1.45rem;font-weight:650;line-height:1.2;margin:.1rem 0 .35rem}
ul{margin:.2rem 0;padding-left:1.1rem}
.figures{columns:24rem 2;column-gap:2rem;margin-top:1.2rem}
figure{margin:0 0 1.2rem;break-inside:avoid}figure svg{width:100%;max-width:27rem;height:auto;fill:var(--ink)}
figcaption{font-size:.88rem;overflow-wrap:anywhere}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums;width:100%}
th,td{text-align:right;vertical-align:top;padding:.28rem .45rem;border-bottom:1px solid var(--rule)}
th{color:var(--soft);font-weight:600}
.text{text-align:left;overflow-wrap:anywhere;min-width:4.5rem}td:first-child{min-width:9.5rem}
@media(max-width:50rem){table,tbody,tr,td{display:block}
thead{display:none}
tr{padding:.5rem 0;border-bottom:1px solid var(--rule)}.text,td:first-child{min-width:0}
td,td.text{display:flex;justify-content:space-between;gap:1rem;text-align:right;border:0;padding:.08rem 0}
td::before{content:attr(data-label);color:var(--soft);text-align:left;flex:none;max-width:45%}
td:first-child{font-weight:650}}
@media print{:root{color-scheme:light;--ink:#000;--soft:#444;--page:#fff;--card:#f4f6f8;--rule:#bbb}
body{max-width:none;padding:0;font-size:10pt}h2{break-after:avoid}tr,figure,.card{break-inside:avoid}}
tr.bold td{font-weight:650}
"""


@dataclass(frozen=True)
class Table:
    """Rows under a header, for a page and for the terminal.

    Attributes:
        header: names of the columns.
        rows: cells: text, or numbers, which the page and the terminal round in their own way; None is unknown.
        note: how the rows are sorted, and what a reader must know; written above the rows.
        bold: of each row, whether it is written in bold; empty: of none.
        text: numbers of the columns that hold text, which is aligned on the left.
        omitted: a column with only such cells is left out.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str | float | None]]
    note: str = ""
    bold: Sequence[bool] = ()
    text: Sequence[int] = (0,)
    omitted: Sequence[str] = ("–", "-", "")

    def cells(self, write: Callable[[float | None], str] = figure) -> list[tuple[str, ...]]:
        """Return the rows as text; `write` rounds a number."""
        return [tuple(c if isinstance(c, str) else write(c) for c in row) for row in self.rows]

    def html(self) -> str:
        """Write the table, never wider than the page; on a narrow page each row is a list of named values."""
        rows = self.cells()
        if not rows:
            return ""
        shown = [k for k in range(len(self.header)) if any(row[k] not in self.omitted for row in rows)]
        css = ["text" if k in self.text else "" for k in range(len(self.header))]
        head = "".join(tag("th", self.header[k], css[k]) for k in shown)
        body = []
        for k, row in enumerate(rows):
            look = ' class="bold"' if k < len(self.bold) and self.bold[k] else ""
            cells = (
                f'<td class="{css[i]}" data-label="{_text(self.header[i])}">{_text(row[i] or "–")}</td>' for i in shown
            )
            body.append(f"<tr{look}>{''.join(cells)}</tr>")
        note = tag("p", self.note, "soft") if self.note else ""
        return f"{note}<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


@dataclass(frozen=True)
class Card:
    """A box that answers one question: a short answer in large letters, then lines.

    Attributes:
        heading, big: the question and the answer.
        lines: what explains the answer, one sentence each.
    """

    heading: str
    big: str
    lines: Sequence[str]
    group: ClassVar[str] = "cards"

    def html(self) -> str:
        """Write the box."""
        return (
            f'<section class="card">{tag("h3", self.heading)}{tag("p", self.big, "big")}{_html(self.lines)}</section>'
        )


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it; without anything below it, nothing is written.

    Attributes:
        heading: its text.
        parts: paragraphs, lists of lines, tables, lists of cards, lists of pictures.
    """

    heading: str
    parts: Sequence

    def html(self) -> str:
        """Write heading and parts."""
        body = "".join(map(_html, self.parts))
        return tag("h2", self.heading) + body if body else ""


@dataclass(frozen=True)
class Page:
    """A page: its first screen answers the question of the reader, the rest gives the evidence.

    Attributes:
        title: the answer in one line.
        kind: what the page shows, above the title.
        first: parts of the first screen, as in `Section`; a notebook shows only this screen.
        rest: the remaining parts.
        css: colour of the title: "good", "open" or none.
    """

    title: str
    kind: str
    first: Sequence
    rest: Sequence = ()
    css: str = ""

    def first_screen(self) -> str:
        """Write the first screen as HTML, without the page around it."""
        return "".join([tag("p", self.kind, "soft"), tag("h1", self.title, self.css), *map(_html, self.first)])

    def html(self) -> str:
        """Write the whole page."""
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
            f"{self.first_screen()}\n{''.join(map(_html, self.rest))}\n</body>\n</html>\n"
        )


@dataclass(frozen=True)
class Link:
    """A paragraph with a link to another page.

    Attributes:
        place: path of the other page from this one.
        text: its title.
    """

    place: str
    text: str

    def html(self) -> str:
        """Write the paragraph."""
        return f'<p><a href="{escape(quote(self.place))}">{_text(self.place)}</a> {tag("span", self.text, "soft")}</p>'


def tag(name: str, text: str, css: str = "") -> str:
    """Write an HTML element around escaped text, without a line break between a number and %."""
    look = f' class="{css}"' if css else ""
    return f"<{name}{look}>{_text(text)}</{name}>"


def _text(text: str) -> str:
    return escape(text).replace(" %", "\N{NARROW NO-BREAK SPACE}%")


def _html(part) -> str:
    """Write a part of a page: a paragraph, a list of lines, cards or pictures, or what writes itself."""
    if isinstance(part, str):
        return tag("p", part) if part else ""
    if not isinstance(part, Iterable):
        return part.html()
    items = list(part)
    if not items:
        return ""
    if isinstance(items[0], str):
        return f"<ul>{''.join(tag('li', line) for line in items)}</ul>"
    return f'<div class="{items[0].group}">{"".join(item.html() for item in items)}</div>'
