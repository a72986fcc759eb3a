"""A fault of a keystore."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KeystoreFault:
    """One fault of a keystore.

    Attributes:
        text: one line with file, line, fault and what was expected.
        advice: what to do.
        is_error: True for a FAIL of ``preflight``, False for a WARN. An error prevents the start of the suite, unless
            `is_weakness` or `of_policy` is true.
        is_weakness: True if the suite can run with the fault, but is less protected; the fault is corrected ashore.
        of_policy: True if the fault concerns rules of governance or permissions, not identities, dates or signatures.
    """

    text: str
    advice: str
    is_error: bool = True
    of_policy: bool = False
    is_weakness: bool = False
