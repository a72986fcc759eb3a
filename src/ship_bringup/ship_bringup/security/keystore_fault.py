"""A fault of a keystore."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KeystoreFault:
    """One fault of a keystore.

    Attributes:
        text: one line with file, line, fault and what was expected.
        advice: what to do.
        is_error: True if the suite must not start with the fault; False for a warning.
        is_weakness: True if the suite can run with the fault, but is less protected; the fault is corrected ashore.
        of_policy: True if the fault concerns the permissions of an enclave, not its identity.
    """

    text: str
    advice: str
    is_error: bool = True
    of_policy: bool = False
    is_weakness: bool = False
