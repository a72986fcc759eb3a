"""Names of topics in a bag against the relative names of the suite."""

from collections.abc import Iterable

TRUTH_PREFIX = "truth/"
"""Topics of simulated bags that hold what an estimator must not see."""


def relative_topic(name: str, namespace: str = "") -> str | None:
    """The suite's relative name of a bag's topic; None where it is outside the namespace.

    Args:
        name: as in the bag, e.g. ``/ship/ins/imu``, ``/ins/imu`` or ``ins/imu``.
        namespace: namespace of the ship in the bag, with or without its slashes; empty = none.
    """
    bare, prefix = name.lstrip("/"), namespace.strip("/")
    if not prefix:
        return bare
    return bare.removeprefix(prefix + "/") if bare.startswith(prefix + "/") else None


def resolved_topic(name: str, namespace: str) -> str:
    """The full name of a topic, as ROS resolves it: a name without a slash at its beginning is in the namespace."""
    return name if name.startswith("/") else "/".join(["", *filter(None, namespace.split("/")), name])


def relative_topics(names: Iterable[str], namespace: str = "") -> dict[str, str]:
    """Relative name → name in the bag, of all topics inside the namespace."""
    pairs = ((relative_topic(name, namespace), name) for name in names)
    return {relative: name for relative, name in pairs if relative is not None}


def namespace_of_outputs(names: Iterable[str], namespace: str, outputs: Iterable[str]) -> str:
    """The namespace that outputs have in a bag: the ship's, or none, as where a replay wrote them.

    Args:
        names: of the bag's topics.
        namespace: of the ship.
        outputs: relative names of which any tells.
    """
    found = relative_topics(names, namespace)
    return namespace if any(topic in found for topic in outputs) else ""


def likely_namespace(names: Iterable[str], wanted: Iterable[str]) -> str | None:
    """A namespace under which all wanted relative names are in the bag; None where there is no single one."""
    bare, needed = {name.lstrip("/") for name in names}, set(wanted)
    if not needed:
        return None
    first = min(needed)
    prefixes = [name.removesuffix("/" + first) for name in bare if name.endswith("/" + first)]
    fitting = [prefix for prefix in prefixes if all(f"{prefix}/{name}" in bare for name in needed)]
    return fitting[0] if len(fitting) == 1 else None
