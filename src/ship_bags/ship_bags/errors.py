"""Exception of the package for bad input, and its one-line text."""

from ship_geometry.input_error import InputError

_LONGEST_LINE = 2000


class BadInput(InputError):
    """A file or an argument cannot be used; the text is one line with the name and the reason."""


def one_line(text: str) -> str:
    """Return a text as one printable line of bounded length, because it may quote a file with control characters."""
    line = " ".join(text.split())
    if len(line) > _LONGEST_LINE:
        line = f"{line[:_LONGEST_LINE]} … ({len(line)} characters)"
    return "".join(character if character.isprintable() else f"\\x{ord(character):02x}" for character in line)
