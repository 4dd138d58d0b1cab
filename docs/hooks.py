"""What MkDocs does beside its plug-ins: it makes the pages of the catalogue and of error messages, and turns links.

Pages of the repository outside `docs/` (OUTSIDE) are part of the site; a link to another file there becomes its name.
Every link of a page is relative to where its text lies in the repository, so the pages read on a forge as they do here.
"""

import posixpath
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import messages
from catalogue import groups, pages  # MkDocs loads hooks with their folder on the path

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {
    "experiments/README.md": "project/experiments.md",
    "benchmarks/README.md": "project/benchmarks.md",
    "benchmarks/CLUSTER.md": "project/cluster.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changes.md",
}
WIDE = ("effects.md", "figures.md", "project/experiments.md", "project/benchmarks.md")  # tables that need the room
FIGURES = "experiments/figures"
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def on_files(files, config):
    """Add the catalogue, the page of error messages, and the pages that lie outside `docs/`."""
    from mkdocs.structure.files import File

    for name, text in pages().items():
        files.append(File.generated(config, f"catalogue/{name}", content=text))
    files.append(File.generated(config, "messages.md", content=messages.page()))
    for source, place in OUTSIDE.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text(encoding="utf-8")))
    for drawn in sorted((ROOT / FIGURES).glob("*.png")):
        files.append(File.generated(config, f"project/figures/{drawn.name}", abs_src_path=str(drawn)))
    return files


def on_config(config):
    """The menu lists every effect by the place where it acts, in plain words, and every decision."""
    folder = Path(__file__).with_name("decisions")
    for entry in config.nav:
        (title, listed) = next(iter(entry.items())) if isinstance(entry, dict) else ("", [])
        if title == "The catalogue":
            made = pages()
            for place, here in groups().items():
                listed.append(
                    {
                        place: [
                            {title.rstrip("."): f"catalogue/{n}.md"} for n, title in here.items() if f"{n}.md" in made
                        ]
                    }
                )
        for page in listed:
            if isinstance(page, dict) and "Decisions" in page:
                page["Decisions"] += sorted(f"decisions/{p.name}" for p in folder.glob("*.md") if p.name != "README.md")
    return config


def on_page_markdown(markdown, page, config, files):
    """Turn links as they stand in the repository into links of the site."""
    place = page.file.src_uri
    if place == "effects.md":
        markdown = with_pages(markdown)
    if place in WIDE:
        page.meta["hide"] = ["toc"]
    origin = {v: k for k, v in OUTSIDE.items()}.get(place, f"docs/{place}")
    return relinked(markdown, origin, place)


def with_pages(markdown: str) -> str:
    """The table of effects, each name a link to its page."""
    made = pages()
    return re.sub(r"^\| `(\w+)` \|", lambda m: f"| [`{m[1]}`](catalogue/{m[1]}.md) |" if f"{m[1]}.md" in made else m[0],
                  markdown, flags=re.M)  # fmt: skip


def relinked(markdown: str, origin: str, place: str) -> str:
    """Links of a page that lies at `origin` in the repository and at `place` in the site."""

    def moved(match):
        mark, text, target = match.groups()
        if "://" in target or target.startswith(("#", "mailto:")):
            return match.group()
        path, _, anchor = target.partition("#")
        there = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
        inside = (
            OUTSIDE.get(there)
            or there.replace(FIGURES, "project/figures") * there.startswith(FIGURES)
            or (there.removeprefix("docs/") if there.startswith("docs/") else None)
        )
        if inside is None:
            return f"{text} (`{there}`)" if not mark else ""
        inside = posixpath.join(inside, "README.md") if path.endswith("/") or inside == "decisions" else inside
        goal = posixpath.relpath(inside, posixpath.dirname(place) or ".")
        return f"{mark}[{text}]({goal}{'#' + anchor if anchor else ''})"

    return LINK.sub(moved, markdown)


def write_sources(folder: Path) -> None:
    """Everything as plain files and a configuration without hooks, for a builder that has none (Zensical)."""
    import yaml

    made = {f"catalogue/{name}": text for name, text in pages().items()}
    made["messages.md"] = messages.page()
    made |= {place: (ROOT / source).read_text(encoding="utf-8") for source, place in OUTSIDE.items()}
    docs = ROOT / "docs"
    made |= {str(p.relative_to(docs).as_posix()): p.read_text(encoding="utf-8") for p in docs.rglob("*.md")}
    made["site.css"] = (docs / "site.css").read_text(encoding="utf-8")
    for place, text in made.items():
        if place.endswith(".md"):
            text = with_pages(text) if place == "effects.md" else text
            text = relinked(text, {v: k for k, v in OUTSIDE.items()}.get(place, f"docs/{place}"), place)
        (folder / "docs" / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / "docs" / place).write_text(text, encoding="utf-8")
    (folder / "docs" / "project" / "figures").mkdir(exist_ok=True)
    for drawn in (ROOT / FIGURES).glob("*.png"):
        shutil.copy(drawn, folder / "docs" / "project" / "figures")
    told = on_config(SimpleNamespace(**yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))))
    kept = {k: v for k, v in vars(told).items() if k != "hooks"}
    kept["plugins"][1]["mkdocstrings"]["handlers"]["python"]["paths"] = [str(ROOT)]
    (folder / "mkdocs.yml").write_text(yaml.safe_dump(kept, sort_keys=False), encoding="utf-8")


if __name__ == "__main__":
    write_sources(Path(sys.argv[1]))
