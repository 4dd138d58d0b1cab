"""Write self-contained HTML pages, with figures as inline SVG that follow light and dark mode.

Nothing is loaded from anywhere: no script, no font, no picture. Every text goes through `html.escape`.
"""

import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from urllib.parse import quote

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from .lines import thin

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
.lead{font-size:1.08rem}
.soft,figcaption,small{color:var(--soft)}
.explained{color:var(--good)}.unknown{color:var(--open)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(17rem,1fr));gap:.8rem;margin:1rem 0}
.card{background:var(--card);border-radius:.6rem;padding:.8rem 1rem}
.big{font-size:1.45rem;font-weight:650;line-height:1.2;margin:.1rem 0 .35rem}
ul{margin:.2rem 0;padding-left:1.1rem}
.figures{columns:24rem 2;column-gap:2rem;margin-top:1.2rem}
figure{margin:0 0 1.2rem;break-inside:avoid}figure svg{width:100%;max-width:27rem;height:auto;fill:var(--ink)}
figcaption{font-size:.88rem;overflow-wrap:anywhere}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums;width:100%}
th,td{text-align:right;vertical-align:top;padding:.28rem .45rem;border-bottom:1px solid var(--rule)}
th:first-child,td:first-child,.long{overflow-wrap:anywhere}td:first-child{min-width:8rem}
th{color:var(--soft);font-weight:600}
th:first-child,td:first-child,.left,.long{text-align:left}
.long{min-width:8rem}
@media(max-width:50rem){table,tbody,tr,td{display:block}
thead{display:none}
tr{padding:.5rem 0;border-bottom:1px solid var(--rule)}.long,td:first-child{min-width:0}
td,td.long,td.left{display:flex;justify-content:space-between;gap:1rem;text-align:right;border:0;padding:.08rem 0}
td::before{content:attr(data-label);color:var(--soft);text-align:left;flex:none;max-width:45%}
td:first-child{font-weight:650}}
@media print{:root{color-scheme:light;--ink:#000;--soft:#444;--page:#fff;--card:#f4f6f8;--rule:#bbb}
body{max-width:none;padding:0;font-size:10pt}h2{break-after:avoid}tr,figure,.card{break-inside:avoid}}
tr.named td{font-weight:650}tr.pale td{color:var(--soft)}
"""
_INCHES, _POINT, _SAMPLES = 3.55, 8.5, 1200
NARROW = "\N{NARROW NO-BREAK SPACE}"
_COLORS = {"#000000": "--ink", "#e6e6e6": "--grid", "#a6a6a6": "--seen", "#0072b2": "--model"}


def page(title: str, parts: Iterable[str]) -> str:
    """Write a whole HTML page around parts that are HTML already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def tag(name: str, text: str, css: str = "") -> str:
    """Write an HTML element around escaped text, without a line break between a number and %."""
    return f"<{name}{_class(css)}>{_text(text)}</{name}>"


def link(place: str, text: str) -> str:
    """Write a paragraph with a link to another page, by its path from this page."""
    return f'<p><a href="{escape(quote(place))}">{_text(place)}</a> {tag("span", text, "soft")}</p>'


def _text(text: str) -> str:
    return escape(text).replace(" %", NARROW + "%")


def _class(css: str) -> str:
    return f' class="{css}"' if css else ""


def card(heading: str, big: str, *lines: str) -> str:
    """Write a box that answers one question: a short answer in large letters, then lines that are HTML already."""
    return f'<section class="card">{tag("h3", heading)}{tag("p", big, "big")}{"".join(lines)}</section>'


def bullets(lines: Sequence[str]) -> str:
    """Write a list of plain texts; empty without texts."""
    return f"<ul>{''.join(tag('li', line) for line in lines)}</ul>" if lines else ""


def table(header: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], css: dict[int, str]) -> str:
    """Write a table that is never wider than the page; on a narrow page each row becomes a list of named values.

    Args:
        header: names of the columns.
        rows: (class, cells).
        css: class of a column by its number: "left" or "long" for text.
    """

    def cells(row: Sequence[str]) -> str:
        return "".join(
            f'<td{_class(css.get(k, ""))} data-label="{_text(header[k])}">{_text(text or "–")}</td>'
            for k, text in enumerate(row)
        )

    head = "".join(tag("th", text or "–", css.get(k, "")) for k, text in enumerate(header))
    body = "".join(f"<tr{_class(kind)}>{cells(row)}</tr>" for kind, row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def telling_table(header: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], css: dict[int, str]) -> str:
    """Write a table without the columns that contain only dashes or zeros."""
    told = [k for k in range(len(header)) if any(cells[k] not in ("–", "0", "") for _, cells in rows)]
    kept = [(kind, [cells[k] for k in told]) for kind, cells in rows]
    return table([header[k] for k in told], kept, {i: css[k] for i, k in enumerate(told) if k in css})


def picture(name: str, drawn: Figure, caption: str) -> str:
    """Write a figure as inline SVG with a caption; black, greys and blue follow the page's colours.

    Args:
        name: unique on the page.
        drawn: any figure; it is redrawn narrow enough for its text to be readable on a telephone.
        caption: one sentence.
    """
    _made_small(drawn)
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):  # so that the same result gives the same page
        text = io.StringIO()
        drawn.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->|\s+xmlns(:\w+)?=\"[^\"]*\"", "", svg, flags=re.DOTALL).replace("xlink:href", "href")
    svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\d\.\d)\d+", r"\1", d[0]), svg)  # a tenth of a point is sufficient
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    for color, role in _COLORS.items():
        svg = svg.replace(color, f"var({role})")
    svg = re.sub(r"<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', svg, count=1)
    return f"<figure>{svg}{tag('figcaption', caption)}</figure>"


def _made_small(drawn: Figure) -> None:
    """Shrink a figure to 3.55 inches, with text of at least 8.5 points and fewer samples per line."""
    wide, high = drawn.get_size_inches()
    drawn.set_size_inches(_INCHES, max(high * (_INCHES / wide) ** 0.7, 1.4))  # lower, labels would fill the plot
    for ax in drawn.axes if len(drawn.axes) > 1 else ():
        ax.set_ylabel(ax.get_ylabel().replace(" (", "\n("))  # labels of two panels would overlap otherwise
    for axis in (a for ax in drawn.axes for a in (ax.xaxis, ax.yaxis) if a.get_scale() == "log"):
        axis.set_major_formatter(lambda value, _: f"{value:g}")  # a small exponent is unreadable
        axis.set_minor_formatter(lambda value, _: "")
    for text in drawn.findobj(Text):
        text.set_fontsize(max(float(text.get_fontsize()), _POINT))
    for line in drawn.findobj(Line2D):
        across, upward = (np.asarray(values) for values in line.get_data())
        if len(across) > _SAMPLES:
            kept = thin(upward.astype(float), _SAMPLES // 4)
            line.set_data(across[kept], upward[kept])
