"""Base class of all errors in user input: in a file, a parameter or an argument.

Errors of all packages derive from this class, so commands can distinguish them from defects of the code.
"""

from typing import Any


class InputError(ValueError):
    """Error in user input.

    The text of the error is for users and is never parsed; programs use the attributes. The arguments are the
    attributes; file and line precede the reason in the text.

    Attributes:
        reason: reason for the refusal in one line, without the file and the line.
        file: name of the file; empty if the input is not in a file, or the file is not known.
        line: line of the file, from 1; None if the line is not known.
        parameters: dotted names of the parameters, the most relevant first; empty if the input is not a parameter.
        value: refused value; None if no single value is refused.
    """

    def __init__(
        self,
        reason: str,
        *,
        file: object = "",
        line: int | None = None,
        parameters: tuple[str, ...] = (),
        value: Any = None,
    ) -> None:
        self.reason, self.file, self.line = reason, str(file), line
        self.parameters, self.value = parameters, value
        place = f"{self.file}:{line}" if line is not None else self.file
        super().__init__(f"{place}: {reason}" if place else reason)
