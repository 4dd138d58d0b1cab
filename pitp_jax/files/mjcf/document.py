"""Edit a MuJoCo file and its includes as text: find a start tag, change its attributes, keep every other byte.

    <joint name="elbow" damping="0.1"/>   ->   <!-- damping: 0.1 -> 0.14 -->
                                               <joint name="elbow" damping="0.14"/>

An XML library would write the whole file anew: quotes, order, blanks and comments of the author would change.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape

from ...common.errors import BadInput, cleaned

# element -> attribute of <compiler> that names the folder of its files
_ASSETS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "flex": "meshdir", "texture": "texturedir"}


@dataclass(frozen=True)
class Tag:
    """One XML start tag with its attributes and its position in a file.

    Attributes:
        file: that holds it.
        name, attributes: of the element.
        path: names of the elements around it, from the root.
        start, end: of the tag in the file's bytes, `end` behind its `>`.
    """

    file: Path
    name: str
    attributes: dict[str, str]
    path: tuple[str, ...]
    start: int
    end: int


@dataclass(frozen=True)
class Document:
    """A MuJoCo file and the files that it includes: bytes, and all XML start tags in the order of the model.

    Attributes:
        main: the file itself.
        texts: bytes by file, the main file first.
        tags: of all files.
    """

    main: Path
    texts: Mapping[Path, bytes]
    tags: tuple[Tag, ...]


def read_document(path: str | Path) -> Document:
    """Read a MuJoCo file and its includes.

    Raises:
        BadInput: no such file, not XML, not a MuJoCo model, or an include that is missing or includes itself.
    """
    main = Path(path)
    texts: dict[Path, bytes] = {}
    tags = tuple(_tags(main, main.parent, (), texts))
    if not tags or tags[0].name != "mujoco":
        raise BadInput(f"{cleaned(main)}: is not a MuJoCo model (its root is not <mujoco>); give the robot's MJCF file")
    return Document(main, texts, tags)


def _tags(file: Path, folder: Path, path: tuple[str, ...], texts: dict[Path, bytes]) -> Iterator[Tag]:
    """Yield the XML start tags of a file; those of an included file replace the `<include>`."""
    if file in texts:
        raise BadInput(f"{cleaned(file)}: is included twice, but MuJoCo takes each file once; remove one include")
    try:
        text = file.read_bytes()
    except OSError as error:
        raise BadInput(f"{cleaned(file)}: {error.strerror or error}; check the path") from None
    texts[file] = text
    for tag in _start_tags(file, text, path):
        if tag.name == "include" and (name := tag.attributes.get("file")):
            # relative to the main file; newer MuJoCo also looks beside the including one
            inner_file = next((p for p in (folder / name, file.parent / name) if p.is_file()), folder / name)
            inner = _tags(inner_file, folder, tag.path, texts)
            next(inner, None)  # its root, <mujocoinclude> or <mujoco>
            yield from inner
        else:
            yield tag


def _start_tags(file: Path, text: bytes, around: tuple[str, ...]) -> list[Tag]:
    tags: list[Tag] = []
    names: list[str] = []
    parser = expat.ParserCreate()

    def begin(name: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        # the root of an included file is not an element of the model
        within = *around, *(names[1:] if around else names)
        tags.append(Tag(file, name, attributes, within, start, _tag_end(text, start)))
        names.append(name)

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda name: names.pop()
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise BadInput(f"{cleaned(file)}: is not XML: {error}; correct the file") from None
    return tags


def _tag_end(text: bytes, start: int) -> int:
    """Return the position after the `>` that closes a start tag; a quoted value may contain `>` too."""
    match = re.compile(rb"""(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(text, start)
    if match is None:  # such as an encoding with two bytes a letter
        raise BadInput("the MuJoCo file is not in UTF-8; save it as UTF-8")
    return match.end()


@dataclass(frozen=True)
class Edit:
    """A change of one XML tag: new attribute values, comments before it, and an element to insert before it."""

    tag: Tag
    attributes: Mapping[str, str]
    comments: Sequence[str] = ()
    element: str = ""


def edited(document: Document, edits: Sequence[Edit], heading: str) -> dict[Path, bytes]:
    """Return the bytes of every file with the edits applied, and a comment at the top of the main file."""
    texts = {file: bytearray(text) for file, text in document.texts.items()}
    root = document.tags[0]
    places = [(e.tag.start, e.tag.end, e.tag.file, e) for e in edits] + [(root.end, root.end, root.file, None)]
    for start, end, file, edit in sorted(places, key=lambda place: place[0], reverse=True):  # backwards: places stay
        text = texts[file]
        # the heading has no tag of its own
        if edit is None:
            text[end:end] = b"\n" + _comment(heading)
            continue
        # comments take the indentation of the tag, or its line if something stands before it
        line = text.rfind(b"\n", 0, start) + 1
        before = bytes(text[line:start])
        between = b"\n" + before if not before.strip() else b" "
        new = filter(None, (*map(_comment, edit.comments), edit.element.encode()))
        said = b"".join(part + between for part in new)
        text[start:end] = said + _with_attributes(bytes(text[start:end]), edit.attributes)
    return {file: bytes(text) for file, text in texts.items()}


def _comment(text: str) -> bytes:
    return f"<!-- {text.replace('--', '- -')} -->".encode()


def _with_attributes(tag: bytes, attributes: Mapping[str, str]) -> bytes:
    """Set attributes in the bytes of an XML tag; existing values are replaced, new attributes come last."""
    for name, value in attributes.items():
        # a value in double or in single quotes
        known = re.compile(rb"(\s" + name.encode() + rb"""\s*=\s*)("[^"]*"|'[^']*')""")
        new = escape(value, {'"': "&quot;"}).encode()
        tag, count = known.subn(lambda m, new=new: m[1] + b'"' + new + b'"', tag, count=1)
        if not count:
            bare = tag.removesuffix(b">").removesuffix(b"/").rstrip()
            tag = bare + b" " + name.encode() + b'="' + new + b'"' + tag[len(bare) :]
    return tag


def assets(document: Document) -> list[Path]:
    """Return the mesh, texture and similar files of the model, relative to the main file's folder.

    A path that leaves the folder, or a file that is not there, is left out.
    """
    compilers = [tag.attributes for tag in document.tags if tag.name == "compiler"]
    said = {key: value for attributes in compilers for key, value in attributes.items()}
    files = []
    for tag in document.tags:
        # a folder for this kind of file, otherwise the one for all
        if (name := tag.attributes.get("file")) and tag.name in _ASSETS:
            place = Path(said.get(_ASSETS[tag.name]) or said.get("assetdir", "")) / name
            if not place.is_absolute() and ".." not in place.parts and (document.main.parent / place).is_file():
                files.append(place)
    return list(dict.fromkeys(files))
