"""Topic names in a bag and the suite's relative names."""

from collections.abc import Iterable

TRUTH_PREFIX = "truth/"
"""Prefix of topics of simulated bags with the truth, which an estimator must not use."""


def relative_topic(name: str, namespace: str = "") -> str | None:
    """Return the suite's relative name of a bag's topic; None for a topic outside the namespace.

    Args:
        name: name of the topic in the bag, e.g. ``/ship/ins/imu``, ``/ins/imu`` or ``ins/imu``.
        namespace: namespace of the ship in the bag, with or without slashes; empty if the bag has no namespace.
    """
    bare, prefix = name.lstrip("/"), namespace.strip("/")
    if not prefix:
        return bare
    return bare.removeprefix(prefix + "/") if bare.startswith(prefix + "/") else None


def resolve_topic(name: str, namespace: str) -> str:
    """Return the full name of a topic as ROS resolves it: a name without leading slash is in the namespace."""
    return name if name.startswith("/") else "/".join(["", *filter(None, namespace.split("/")), name])


def relative_topics(names: Iterable[str], namespace: str = "") -> dict[str, str]:
    """Return relative name → name in the bag, for all topics inside the namespace."""
    pairs = ((relative_topic(name, namespace), name) for name in names)
    return {relative: name for relative, name in pairs if relative is not None}


def namespace_of_outputs(names: Iterable[str], namespace: str, outputs: Iterable[str]) -> str:
    """Return the namespace of the outputs in a bag: the ship's, or an empty one as in a bag written by a replay.

    Args:
        names: names of the bag's topics.
        namespace: namespace of the ship.
        outputs: relative names of outputs; if one of these outputs is in the ship's namespace, this namespace is
            returned.
    """
    found = relative_topics(names, namespace)
    return namespace if any(topic in found for topic in outputs) else ""


def likely_namespace(names: Iterable[str], wanted: Iterable[str]) -> str | None:
    """Return the namespace with all wanted relative names in the bag; None unless there is exactly one."""
    bare, needed = {name.lstrip("/") for name in names}, set(wanted)
    if not needed:
        return None
    first = min(needed)
    prefixes = [name.removesuffix("/" + first) for name in bare if name.endswith("/" + first)]
    fitting = [prefix for prefix in prefixes if all(f"{prefix}/{name}" in bare for name in needed)]
    return fitting[0] if len(fitting) == 1 else None
