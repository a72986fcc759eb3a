"""Check of DDS security, the ship's keystore and its policies."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from ship_bags.live.dds import ENABLE, is_security_requested
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.security.demand import KEYSTORE, security_problems
from ship_bringup.security.keystore import KeystoreUse, keystore_faults

_SECURITY, _KEYSTORE, _POLICIES = "security", "keystore", "policies"


def check_security(
    environment: Mapping[str, str], has_security: bool | None, is_required: bool
) -> Iterator[CheckLine]:
    """Check that DDS security is available and enforced.

    The result without security is FAIL if the ship's limits or the environment demand security, else WARN.

    Args:
        environment: environment of the process.
        has_security: True if DDS was built with security; None if unknown.
        is_required: True if the ship's limits demand security (machine.require_security).
    """
    found = security_problems(environment, has_security)
    if not found:
        yield CheckLine(_SECURITY, Result.OK, "available in DDS, and enforced by the environment")
    elif is_required or is_security_requested(environment):
        demand = "machine.require_security" if is_required else ENABLE
        for text, advice in found:
            yield CheckLine(_SECURITY, Result.FAIL, f"{demand} demands it, and {text}", advice)
    else:
        text = "off: any computer on the network can read and publish all topics"
        advice = "not demanded here; to use it: docs/how-to/security.md"
        yield CheckLine(_SECURITY, Result.WARN, text, advice)


def check_keystore(keystore: str, use: KeystoreUse, is_required: bool) -> Iterator[CheckLine]:
    """Check the keystore and the policies in it.

    Args:
        keystore: folder of the keystore; empty if the environment names no keystore.
        use: requirements of the suite on the keystore.
        is_required: True if the ship's limits or the environment demand security. A check that cannot be made is then a
            FAIL, otherwise NOT_CHECKED.
    """
    unchecked = Result.FAIL if is_required else Result.NOT_CHECKED
    if not keystore:
        yield CheckLine(_KEYSTORE, unchecked, f"{KEYSTORE} is not set")
        return
    try:
        faults = keystore_faults(Path(keystore), use)
    except LookupError:
        yield CheckLine(_KEYSTORE, unchecked, "no program openssl, which checks signatures", "sudo apt install openssl")
        return
    for fault in faults:
        result = Result.FAIL if fault.is_error else Result.WARN
        yield CheckLine(_POLICIES if fault.of_policy else _KEYSTORE, result, fault.text, fault.advice)
    enclaves = sum(1 for rights in use.rights if (Path(keystore) / "enclaves" / rights.enclave.lstrip("/")).is_dir())
    if not any(fault.is_error and not fault.of_policy for fault in faults):
        found = f"{keystore}: {enclaves} enclaves of this suite, signed by its authority"
        yield CheckLine(_KEYSTORE, Result.OK, found)
    if enclaves and not any(fault.of_policy for fault in faults):
        yield CheckLine(_POLICIES, Result.OK, "they allow what the code declares and no more")

