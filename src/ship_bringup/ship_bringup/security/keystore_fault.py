"""One fault of a keystore."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KeystoreFault:
    """One thing that is wrong.

    Attributes:
        text: one line: file, line, what it is and what was expected.
        advice: what to do.
        is_error: whether the suite is not to start with it; otherwise people should know.
        is_weakness: whether the suite can run with it all the same, less protected: mended ashore, not at sea.
        of_policy: whether it is about what an enclave may do, and not about who it is.
    """

    text: str
    advice: str
    is_error: bool = True
    of_policy: bool = False
    is_weakness: bool = False
