"""Base class of all errors in user input: a file, a parameter, an argument.

It is in the lowest package because all packages derive errors from it, which commands distinguish from defects of the
code.
"""

from typing import Any


class InputError(ValueError):
    """Error in user input.

    The text is for users and is never parsed: programs use the attributes.

    Attributes:
        reason: what is wrong, without the file and the line.
        file: name of the file; empty if the input is not a file, or the file is not known here.
        line: line of the file, from 1; None if it is not known.
        parameters: dotted names of the parameters, the most relevant one first; empty if the input is not a parameter.
        value: the refused value; None if there is none.

    Args:
        reason: as above; one line.
        file: as above; precedes the reason in the text.
        line: as above; follows the file.
        parameters: as above.
        value: as above.
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
