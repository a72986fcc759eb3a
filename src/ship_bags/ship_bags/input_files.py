"""Input files of users: check for a regular file, and reader of YAML with limits.

Opening a pipe waits for its other end, and reading a device may never end. Neither must block the start of a node. A
YAML text that is too long, too deep or expands without end is refused.
"""

import errno
import functools
import os
import stat
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput

MAX_TEXT_LENGTH = 4_000_000
"""Maximum length of a text, characters; the parser takes minutes for a longer text."""

MAX_NESTING = 50
MAX_NODES = 1_000_000
"""Maximum number of values of a document with its aliases expanded."""

_LONGEST_INTEGER = 30
_FIRST_TOO_LARGE = 2**63
_TOO_DEEP = "nested too deeply, or a group that contains itself by an alias"


def check_regular(path: Path) -> None:
    """Raise an error unless a path is a regular file; a missing file is reported later, when it is opened.

    Raises:
        OSError: EISDIR for a folder, ESPIPE for a pipe, a device or a socket.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        reason = errno.EISDIR if stat.S_ISDIR(mode) else errno.ESPIPE
        raise OSError(reason, open_error_text(reason), str(path))


def open_error_text(number: int) -> str:
    """Return the text of an error at opening a file, by its error number."""
    if number == errno.EISDIR:
        return "it is a folder: expected a file"
    if number == errno.ESPIPE:
        return "it is a pipe, a device or a socket: expected a file"
    return os.strerror(number)


class _DataLoader(yaml.SafeLoader):
    """YAML loader that accepts only integers of 64 bits; a larger integer would fail later, when used or shown."""

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        if len(node.value) <= _LONGEST_INTEGER:
            value = int(super().construct_yaml_int(node))
            if -_FIRST_TOO_LARGE <= value < _FIRST_TOO_LARGE:
                return value
        raise yaml.constructor.ConstructorError(None, None, "a whole number of more than 64 bits", node.start_mark)


_DataLoader.add_constructor("tag:yaml.org,2002:int", _DataLoader.construct_yaml_int)


# A node parses the same file twice at its start: to check it before ROS reads it, and for the warnings about it.
@functools.lru_cache(maxsize=1)
def compose(name: str, text: str) -> yaml.Node | None:
    """Return the document of a text as YAML nodes with their lines; None if the text is empty.

    Args:
        name: name of the file, for texts.
        text: content of the file.

    Raises:
        BadInput: the text is not YAML or exceeds a bound; the error names the file and, if known, the line.
    """
    if len(text) > MAX_TEXT_LENGTH:
        raise BadInput(f"{len(text)} characters: expected a text of at most {MAX_TEXT_LENGTH}", file=name)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if root is not None and _size(root, {}, ()) > MAX_NODES:
            raise BadInput(f"its aliases expand to more than {MAX_NODES} values", file=name)
    except RecursionError as error:
        raise BadInput(_TOO_DEEP, file=name) from error
    except (yaml.YAMLError, ValueError) as error:
        raise _yaml_error(name, error) from error
    return root


def plain_data(name: str, text: str) -> Any:
    """Return the document of a text as mappings, lists and scalars.

    Raises:
        BadInput: as :func:`compose`, or a value is invalid: an impossible date, a number with too many digits.
    """
    root = compose(name, text)
    return None if root is None else data_of(name, root)


def data_of(name: str, node: yaml.Node) -> Any:
    """Return a node of :func:`compose` as mappings, lists and scalars.

    Raises:
        BadInput: a value is invalid; the error names the file and the line.
    """
    try:
        return _DataLoader("").construct_object(node, deep=True)
    except (yaml.YAMLError, ValueError) as error:
        raise _yaml_error(name, error, node.start_mark) from error


def _size(node: yaml.Node, known: dict[int, int], above: tuple[int, ...]) -> int:
    """Return the number of values of a node with its aliases expanded.

    Raises:
        RecursionError: the nesting is too deep.
        ValueError: a text in the node is invalid.
    """
    if id(node) in known:
        return known[id(node)]
    if len(above) > MAX_NESTING or id(node) in above:
        raise RecursionError
    above = (*above, id(node))
    children: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        children = [part for entry in node.value for part in entry]
    elif isinstance(node, yaml.SequenceNode):
        children = node.value
    elif any("\ud800" <= character <= "\udfff" for character in node.value):
        # An escape can give half of a character, which cannot be encoded.
        raise ValueError(f"an invalid character in line {node.start_mark.line + 1}")
    known[id(node)] = 1 + sum(_size(child, known, above) for child in children)
    return known[id(node)]


def _yaml_error(name: str, error: Exception, mark: yaml.Mark | None = None) -> BadInput:
    """Return the error as one line without the file's text, which must not appear in messages."""
    if isinstance(error, BadInput):
        return error
    reason = str(error)
    if isinstance(error, yaml.MarkedYAMLError):
        mark, reason = error.problem_mark or error.context_mark or mark, str(error.problem or error.context)
    line = None if mark is None else mark.line + 1
    return BadInput(f"not YAML: {reason.splitlines()[0]}", file=name, line=line)
