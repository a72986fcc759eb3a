"""The base of every error about what somebody gave: a file, a parameter, an argument.

It lies in the lowest package because the packages above raise errors of their own that a command must be able to tell,
as one kind, from faults in the code.
"""

from typing import Any


class InputError(ValueError):
    """What somebody gave cannot be used.

    The text is for people and is never parsed: what a program needs to know stands in the attributes.

    Attributes:
        reason: what is wrong, without the file and the line.
        file: name of the file at fault; empty where it is not a file, or not known here.
        line: line of the file, from 1; None where it is not known.
        parameters: dotted names of the parameters at fault, the first one being where to look; empty where it is not a
            parameter.
        value: the value that was refused; None where there is none.

    Args:
        reason: as above; one line.
        file: as above; stands before the reason in the text.
        line: as above; stands behind the file.
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
