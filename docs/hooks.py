"""What MkDocs does beside its plug-ins: the catalogue's pages are made, and links out of `docs/` find their place.

Pages of the repository outside `docs/` (OUTSIDE) are part of the site; a link to another file there becomes its name.
Every link of a page is relative to where its text lies in the repository, so the pages read on a forge as they do here.
"""

import posixpath
import re
from pathlib import Path

from catalogue import pages, rows_of_effects  # MkDocs loads hooks with their folder on the path
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {
    "experiments/README.md": "project/experiments.md",
    "benchmarks/README.md": "project/benchmarks.md",
    "benchmarks/CLUSTER.md": "project/cluster.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changes.md",
}
FIGURES = "experiments/figures"
NOT_DRAWN = ("parameter_change",)  # the nominal's own coefficients: no form
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def on_files(files, config):
    """Add the catalogue and the pages that lie outside `docs/`."""
    for name, text in pages().items():
        files.append(File.generated(config, f"catalogue/{name}", content=text))
    for source, place in OUTSIDE.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text(encoding="utf-8")))
    for drawn in sorted((ROOT / FIGURES).glob("*.png")):
        files.append(File.generated(config, f"project/figures/{drawn.name}", abs_src_path=str(drawn)))
    return files


def on_config(config):
    """The menu lists every effect and every decision."""
    folder = Path(__file__).with_name("decisions")
    for entry in config.nav:
        (title, listed) = next(iter(entry.items())) if isinstance(entry, dict) else ("", [])
        if title == "The catalogue":
            listed += [f"catalogue/{name}.md" for name in rows_of_effects() if name not in NOT_DRAWN]
        for page in listed:
            if isinstance(page, dict) and "Decisions" in page:
                page["Decisions"] += sorted(f"decisions/{p.name}" for p in folder.glob("*.md") if p.name != "README.md")
    return config


def on_page_markdown(markdown, page, config, files):
    """Turn links as they stand in the repository into links of the site."""
    place = page.file.src_uri
    origin = {v: k for k, v in OUTSIDE.items()}.get(place, f"docs/{place}")
    return relinked(markdown, origin, place)


def relinked(markdown: str, origin: str, place: str) -> str:
    """Links of a page that lies at `origin` in the repository and at `place` in the site."""

    def moved(match):
        mark, text, target = match.groups()
        if "://" in target or target.startswith(("#", "mailto:")):
            return match.group()
        path, _, anchor = target.partition("#")
        there = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
        inside = OUTSIDE.get(there) or there.replace(FIGURES, "project/figures") * there.startswith(FIGURES) or (there.removeprefix("docs/") if there.startswith("docs/") else None)
        if inside is None:
            return f"{text} (`{there}`)" if not mark else ""
        inside = posixpath.join(inside, "README.md") if path.endswith("/") or inside == "decisions" else inside
        goal = posixpath.relpath(inside, posixpath.dirname(place) or ".")
        return f"{mark}[{text}]({goal}{'#' + anchor if anchor else ''})"

    return LINK.sub(moved, markdown)
