"""JSON, YAML and OpenCV's XML, from bytes to plain values: one strict reader of each.

A file is one tree of `dict`, `list`, `str`, `int`, `float`, `bool` and None. A key that is there twice, too many bytes,
an unknown encoding, anchors and entities are refused by name: of what a lax parser drops or makes up, nobody hears.
"""

from __future__ import annotations

import codecs
import json
import re
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from twohands.errors import DataFormatError
from twohands.files import read_file

MAX_BYTES: Final = 64 << 20
"""Of a JSON file: predictions of 100,000 pictures in full take 1 GB, and belong into an npz."""

_BYTE_ORDER_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_GZIP: Final = b"\x1f\x8b"
_MOST_DIGITS: Final = 400
"""Of a number: no float needs as many, and Python refuses to read thousands."""
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_MOST_LEVELS: Final = 32
"""Of lists and mappings in each other, in YAML."""
_WORDS: Final = {
    "true": True, "false": False, "null": None, "~": None, "": None,
    ".nan": float("nan"), ".inf": float("inf"), "+.inf": float("inf"), "-.inf": -float("inf"),
}  # fmt: skip
"""What plain words of YAML mean, in small letters."""


def read_bytes(path: Path, what: str = "file", limit: int = MAX_BYTES) -> bytes:
    """A file's content, all of it; a gzipped one unpacked, whatever its name.

    Args:
        path: the file.
        what: it is, for messages: "camera file".
        limit: bytes that it may have, unpacked.

    Raises:
        InputError: there is no such file, or it cannot be read.
        DataFormatError: it is empty, too large, or a damaged gzip file.
    """
    data = read_file(path, limit, what)
    if data.startswith(_GZIP):
        data = _unpacked(data, path, limit)
    if len(data) > limit:
        raise DataFormatError(f"{path}: {what} of more than {limit >> 20} MiB")
    if not data or data.isspace():
        raise DataFormatError(f"{path}: {what} is empty")
    return data


def _unpacked(data: bytes, path: Path, limit: int) -> bytes:
    unpacker = zlib.decompressobj(wbits=31)
    try:
        unpacked = unpacker.decompress(data, limit + 1)
    except zlib.error as error:
        raise DataFormatError(f"{path}: not a complete gzip file: {error}") from None
    if len(unpacked) <= limit and not unpacker.eof:
        raise DataFormatError(f"{path}: not a complete gzip file: cut off")
    return unpacked


def decode_text(data: bytes) -> str:
    """Text of a file: UTF-8, or what its byte order mark says.

    Raises:
        DataFormatError: it is none.
    """
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in data[:4]:
        raise DataFormatError("not text in UTF-8 (zero bytes; UTF-16 and UTF-32 need a byte order mark)")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataFormatError(f"not text in {encoding.removesuffix('-sig').upper()} (byte {error.start})") from None


def parse_json(data: bytes | str) -> Any:
    """The value that a JSON text holds. NaN and Infinity, which Python writes though JSON has none, are numbers.

    Raises:
        DataFormatError: it is no text, not JSON, nested too deeply, or an object has a key twice.
    """
    text = decode_text(data) if isinstance(data, bytes) else data
    try:
        return json.loads(text, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise DataFormatError(f"not JSON: {_one_line(error)}") from None


def read_json(path: Path, kind: type, what: str = "JSON file", limit: int = MAX_BYTES) -> Any:
    """Reads a JSON file.

    Args:
        path: the file; may be gzipped.
        kind: type of its top level, `dict` or `list`.
        what: it is, for messages.
        limit: bytes that it may have.

    Raises:
        InputError: there is no such file, or it cannot be read.
        DataFormatError: it is not JSON, or of another kind.
    """
    try:
        content = parse_json(read_bytes(path, what, limit))
    except DataFormatError as error:
        raise DataFormatError(_with_path(path, error)) from None
    if not isinstance(content, kind):
        raise DataFormatError(f"{path}: expected a JSON {kind.__name__}, got a {type(content).__name__}")
    return content


def parse_yaml(text: str) -> Any:
    """The value that a YAML text holds, also OpenCV's with `%YAML:1.0` before it; tags are left out.

    Raises:
        DataFormatError: it is not YAML, several documents, nested too deeply, uses anchors, or has a key twice.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _yaml_tree(yaml.parse(_without_directives(text), loader))
    except yaml.MarkedYAMLError as error:
        where = f" (line {error.problem_mark.line + 1})" if error.problem_mark else ""
        raise DataFormatError(f"not YAML: {_one_line(error.problem or error)}{where}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise DataFormatError(f"not YAML: {_one_line(error)}") from None


def parse_xml(text: str) -> dict[str, Any]:
    """The values of an XML file of OpenCV's FileStorage; a matrix as in its JSON, with rows, cols, dt and data.

    Raises:
        DataFormatError: it is not XML, no `opencv_storage`, declares entities, or has a key twice.
    """
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise DataFormatError("not XML of OpenCV: declarations (<!...) are not read")
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
        if root.tag != "opencv_storage":
            raise DataFormatError(f"XML, but not of OpenCV: <opencv_storage> expected, found <{root.tag[:60]}>")
        return _object([(child.tag, _xml_value(child)) for child in root])
    except (ElementTree.ParseError, RecursionError, ValueError) as error:
        raise DataFormatError(f"not XML: {_one_line(error)}") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of unique keys."""
    record = dict(pairs)
    if len(record) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key '{twice[:60]}' is there twice")
    return record


def _without_directives(text: str) -> str:
    """The text without lines that begin with % before its first value; OpenCV's `%YAML:1.0` is no YAML."""
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if line.startswith("%"):
            lines[number] = ""
        elif line.strip() and not line.lstrip().startswith("#"):
            break
    return "\n".join(lines)


def _yaml_tree(events: Iterable[Any]) -> Any:
    """The value that a parser's events tell of. Put together here, since a composer would follow aliases, take keys
    twice and call itself without limit."""
    import yaml

    open_ones: list[list[Any]] = [[]]  # contents so far of the document and of every list or mapping that is open
    for event in events:
        if getattr(event, "anchor", None) is not None:
            raise ValueError("anchors and aliases (& and *) are not read")
        if isinstance(event, yaml.CollectionStartEvent):
            open_ones.append([])
            if len(open_ones) > _MOST_LEVELS:
                raise ValueError(f"nested more than {_MOST_LEVELS} levels deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            items = open_ones.pop()
            mapping = isinstance(event, yaml.MappingEndEvent)
            pairs = zip(map(str, items[::2]), items[1::2], strict=True) if mapping else ()
            open_ones[-1].append(_object(list(pairs)) if mapping else items)
        elif isinstance(event, yaml.ScalarEvent):
            open_ones[-1].append(event.value if event.style else _word(event.value))
    documents = [document for document in open_ones[0] if document is not None]  # an empty one ends `ros2 topic echo`
    if len(documents) > 1:
        raise ValueError("several documents (---), one expected")
    return documents[0] if documents else None


def _xml_value(element: ElementTree.Element) -> Any:
    """An element as a plain value: its children, or the words of its text."""
    children = list(element)
    if children and all(child.tag == "_" for child in children):
        return [_xml_value(child) for child in children]
    if children:
        return _object([(child.tag, _xml_value(child)) for child in children])
    text = (element.text or "").strip()
    if text.startswith('"'):
        return text.strip('"')
    words = [_word(word) for word in text.split()]
    if all(isinstance(word, int | float) for word in words) and len(words) != 1:
        return words
    return words[0] if len(words) == 1 else text


def _word(text: str) -> Any:
    """A plain word of YAML or XML: a number where it is one."""
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if len(text) > _MOST_DIGITS or not _NUMBER.fullmatch(text):
        return text
    return int(text) if text.lstrip("+-").isdecimal() else float(text)


def _with_path(path: Path, error: Exception) -> str:
    message = str(error)
    return message if message.startswith(f"{path}: ") else f"{path}: {message}"


def _one_line(error: object) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
