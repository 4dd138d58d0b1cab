"""One self-contained HTML page: its style, its parts, and figures as inline SVG that follow light and dark.

Nothing is loaded from anywhere: no script, no font, no picture. Every text goes through `html.escape`.
"""

import io
import re
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib import rc_context
from matplotlib.figure import Figure

_STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#5b6570;--page:#fff;--card:#f4f6f8;--rule:#dde2e7;--grid:#e6e6e6;
--seen:#a6a6a6;--model:#0072b2;--good:#00734f;--open:#9a5b00}
@media(prefers-color-scheme:dark){:root{--ink:#e8eaed;--soft:#a3acb5;--page:#15181c;--card:#1f2429;--rule:#343b42;
--grid:#33393f;--seen:#8b8f94;--model:#56b4e9;--good:#4cc79b;--open:#f0b04c}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1.1rem 1rem 3rem;max-width:72rem;background:var(--page);color:var(--ink);
font:16px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
h1{font-size:1.75rem;line-height:1.2;margin:.1rem 0 .3rem}
h2{font-size:1.2rem;margin:2.2rem 0 .5rem}
h3{font-size:.8rem;text-transform:uppercase;letter-spacing:.07em;color:var(--soft);margin:0 0 .3rem}
p{margin:.35rem 0;max-width:46rem}
.lead{font-size:1.08rem}
.soft,figcaption,small{color:var(--soft)}
.explained{color:var(--good)}.unknown{color:var(--open)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(17rem,1fr));gap:.8rem;margin:1rem 0}
.card{background:var(--card);border-radius:.6rem;padding:.8rem 1rem}
.big{font-size:1.45rem;font-weight:650;line-height:1.2;margin:.1rem 0 .35rem}
ul{margin:.2rem 0;padding-left:1.1rem}
.figures{columns:24rem 2;column-gap:2rem}
figure{margin:0 0 1.2rem;break-inside:avoid}figure svg{width:100%;height:auto;fill:var(--ink)}
figcaption{font-size:.88rem}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.88rem;font-variant-numeric:tabular-nums;width:100%}
th,td{text-align:right;padding:.28rem .6rem;border-bottom:1px solid var(--rule);white-space:nowrap}
th{color:var(--soft);font-weight:600}
th:first-child,td:first-child,.left{text-align:left}
.long{text-align:left;white-space:normal;min-width:16rem}
tr.named td{font-weight:650}tr.pale td{color:var(--soft)}
"""
NARROW = "\N{NARROW NO-BREAK SPACE}"
_COLORS = {"#000000": "--ink", "#e6e6e6": "--grid", "#a6a6a6": "--seen", "#0072b2": "--model"}


def page(title: str, parts: Iterable[str]) -> str:
    """The page around its parts, which are HTML already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def tag(name: str, text: str, css: str = "") -> str:
    """An element around escaped text; no line breaks between a number and its %."""
    return f"<{name}{_class(css)}>{escape(text).replace(' %', NARROW + '%')}</{name}>"


def _class(css: str) -> str:
    return f' class="{css}"' if css else ""


def card(heading: str, big: str, *lines: str) -> str:
    """A box that answers one question: its short answer large, then lines that are HTML already."""
    return f'<section class="card">{tag("h3", heading)}{tag("p", big, "big")}{"".join(lines)}</section>'


def bullets(lines: Sequence[str]) -> str:
    """A list of plain texts; nothing where there are none."""
    return f"<ul>{''.join(tag('li', line) for line in lines)}</ul>" if lines else ""


def table(header: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], css: dict[int, str]) -> str:
    """A table that scrolls sideways on a narrow screen; rows are (class, cells), `css` the classes of columns."""

    def cells(name: str, texts: Sequence[str]) -> str:
        return "".join(tag(name, text, css.get(k, "")) for k, text in enumerate(texts))

    body = "".join(f"<tr{_class(kind)}>{cells('td', row)}</tr>" for kind, row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{cells("th", header)}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def telling_table(header: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], css: dict[int, str]) -> str:
    """The same without columns in which every row has a dash or a zero."""
    told = [k for k in range(len(header)) if any(cells[k] not in ("–", "0", "") for _, cells in rows)]
    kept = [(kind, [cells[k] for k in told]) for kind, cells in rows]
    return table([header[k] for k in told], kept, {i: css[k] for i, k in enumerate(told) if k in css})


def picture(name: str, drawn: Figure, caption: str) -> str:
    """A figure as inline SVG with a caption; its black, greys and blue follow the page's colours."""
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):  # the same diagnosis is the same page
        text = io.StringIO()
        drawn.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->|\s+xmlns(:\w+)?=\"[^\"]*\"", "", svg, flags=re.DOTALL).replace("xlink:href", "href")
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    for color, role in _COLORS.items():
        svg = svg.replace(color, f"var({role})")
    svg = re.sub(r"<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', svg, count=1)
    return f"<figure>{svg}{tag('figcaption', caption)}</figure>"
