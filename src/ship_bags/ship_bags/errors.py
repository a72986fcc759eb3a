"""The package's one exception for bad input, and how what it says is shown."""

from ship_geometry.input_error import InputError

_LONGEST_LINE = 2000


class BadInput(InputError):
    """A file or an argument cannot be used; the text is one line that says which, and why."""


def one_line(text: str) -> str:
    """A text for the terminal in one line of bounded length: it may quote a file, and so hold control characters."""
    line = " ".join(text.split())
    if len(line) > _LONGEST_LINE:
        line = f"{line[:_LONGEST_LINE]} … ({len(line)} characters)"
    return "".join(character if character.isprintable() else f"\\x{ord(character):02x}" for character in line)
