"""Identities of the programs of a suite in DDS security, if security is demanded."""

import datetime
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import full_name
from ship_bringup.security.demand import KEYSTORE, domain_of, enclave_command
from ship_bringup.security.keystore import KeystoreUse, require_keystore
from ship_bringup.security.rights import Rights
from ship_bringup.suite.program import Program
from ship_watch.safety.limits import Limits


def add_enclaves(
    programs: Sequence[Program], all_rights: Sequence[Rights], namespace: str, limits: Limits
) -> tuple[list[Program], list[str]]:
    """Return the programs, each in the enclave of its name, and warnings about the ship's keystore.

    Args:
        programs: programs of the suite.
        all_rights: rights of all programs that may belong to the suite.
        namespace: namespace of the suite.
        limits: limits of the ship, which may contain the SHA-256 of the ship's authority.

    Raises:
        BadInput: there is no keystore, or the suite cannot start with it (:func:`require_keystore`).
    """
    keystore = os.environ.get(KEYSTORE)
    if not keystore:
        raise BadInput(f"DDS security is demanded, and {KEYSTORE} is not set: not started; it names the keystore")
    enclaves = [full_name(program.name, namespace) for program in programs]
    use = KeystoreUse(
        rights=[replace(each, is_needed=True) for each in all_rights if each.enclave in enclaves],
        domain_id=domain_of(os.environ),
        now=datetime.datetime.now(datetime.timezone.utc),
        voyage=datetime.timedelta(0),
        authority_sha256=limits.machine.authority_sha256,
    )
    warnings = require_keystore(Path(keystore), use)
    secured = [
        replace(program, command=(*enclave_command(enclave), *program.command))
        for program, enclave in zip(programs, enclaves, strict=True)
    ]
    return secured, warnings
