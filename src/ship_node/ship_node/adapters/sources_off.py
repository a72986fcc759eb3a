"""Sources of a node that the parameter ``sources_off`` switches off; their messages are counted and not used."""

from collections.abc import Collection, Iterable

from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_node.adapters.feeds import Feed
from ship_node.messages.common_messages import DiagnosticStatus, Level

SOURCE_OFF = Rejection(Reason.OFF, "switched off by sources_off")
"""Rejection of a message whose source is switched off."""


def disabled_topics(
    feeds: Iterable[Feed], sources_off: tuple[str, ...], required_sources: Collection[str]
) -> frozenset[str]:
    """Return the topics of sources that are switched off.

    Args:
        feeds: inputs of the node.
        sources_off: the parameter.
        required_sources: sources without which there is no output.

    Raises:
        ParameterError: a source is unknown or cannot be switched off.
    """
    topics = {feed.source: feed.input.topic for feed in feeds}
    for source in sources_off:
        if source in required_sources:
            reason = (
                f"'{source}' cannot be switched off: without it there is no output. To test that, stop the "
                f"publisher of {topics[source]}; to use another device, remap {topics[source]} at the start"
            )
        elif source not in topics:
            names = ", ".join(name for name in topics if name not in required_sources)
            reason = f"there is no source {source!r}: expected some of {names}"
        else:
            continue
        raise ParameterError(f"parameter 'sources_off': {reason}", "sources_off", value=sources_off)
    return frozenset(topics[source] for source in sources_off)


def off_statuses(feeds: Iterable[Feed], off_topics: Collection[str]) -> list[DiagnosticStatus]:
    """Return a status with the sources that are switched off; an empty list if all are on."""
    names = [feed.source for feed in feeds if feed.input.topic in off_topics]
    text = f"switched off by sources_off: {', '.join(names)}"
    return [DiagnosticStatus("sources off", Level.WARN, text)] if names else []
