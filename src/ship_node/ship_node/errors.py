"""The package's one exception for bad input."""


class BadInput(ValueError):
    """A file, an argument or a parameter cannot be used; the text is one line that says which, and why."""
