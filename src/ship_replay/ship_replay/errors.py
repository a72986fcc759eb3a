"""The package's exception for bad input."""


class BadInput(ValueError):
    """A file, topic, message or option cannot be used; the text names it and says what was expected."""
