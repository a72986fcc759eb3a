"""Run of one item: simulation of a scenario, replay through the suite's nodes, evaluation against the truth."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.renamed_topics import TopicNames, topic_names
from ship_geometry.input_error import InputError
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.statistics import AttitudeErrors
from ship_replay.offline.digests import code_sha256
from ship_replay.offline.nodes import ADAPTERS
from ship_replay.offline.replay import replay
from ship_replay.offline.replay_summary import ReplaySummary
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_studies.campaign.items import Item

Result = dict[str, Any]
"""Result of an item as plain data for JSON:

- ``error``: text of the error; None on success;
- ``errors``: label of a source → its ``channels``, its statistics with the names of ``evaluate --json``,
  ``nees_count`` (number of NEES) and ``nees_independent`` (equivalent number of independent NEES);
- ``values``: all quantities of ``evaluate --json``;
- ``statuses``: topic → status → number of outputs;
- ``refused``: topic → reason → number of messages not used.
"""


def run_item(item: Item, folder: Path) -> Result:
    """Run an item; errors are reported in the result.

    Args:
        item: the item.
        folder: empty folder for intermediate bags.
    """
    try:
        return _run(item, folder)
    except InputError as problem:
        error = str(problem)
    except Exception as problem:
        # A software defect in one run must not stop the others.
        error = f"{type(problem).__name__}: {problem}"
    # Without paths, the text is the same on every machine.
    error = error.replace(f"{folder}/", "").replace(str(item.source.path), item.source.name)
    if item.parameters is not None:
        error = error.replace(str(item.parameters.path), item.parameters.name)
    return failed_result(error)


def failed_result(error: str) -> Result:
    """Return the result of an item that failed."""
    return {"error": error, "errors": {}, "values": {}, "statuses": {}, "refused": {}}


def _run(item: Item, folder: Path) -> Result:
    if item.code != code_sha256():
        raise InputError("the worker's version of the suite or of its libraries differs from that of the campaign")
    input_files = [item.source] if item.parameters is None else [item.source, item.parameters]
    for file in input_files:
        file.check()
    bag, out = item.source.path, folder / "out.mcap"
    if item.seed is not None:
        bag = folder / "in.mcap"
        write_bag(load_scenario(item.source.path), item.seed, bag, item.source.path.read_bytes())
    config = None if item.parameters is None else item.parameters.path
    with topic_names(TopicNames(item.remaps, item.namespace, is_by_suite=True, suite_file=config)):
        summary = replay(bag, out, ADAPTERS, config, item.namespace)
        return _as_result(evaluate(out, bag, item.skip_s, item.namespace), summary)


def _as_result(evaluation: Evaluation, summary: ReplaySummary) -> Result:
    return {
        "error": None,
        "errors": {errors.label: _statistics(errors) for errors in evaluation.errors},
        "values": _json_values(evaluation.quantities()),
        "statuses": {
            topic: dict(sorted(history.counts.items())) for topic, history in sorted(summary.status_histories.items())
        },
        "refused": {topic: dict(sorted(reasons.items())) for topic, reasons in sorted(summary.rejected.items())},
    }


def _statistics(errors: AttitudeErrors) -> dict[str, Any]:
    nees = errors.nees[np.isfinite(errors.nees)]
    values = errors.statistics() | {"nees_mean": float(np.mean(nees)) if len(nees) else math.nan}
    counts = {"nees_count": float(len(nees)), "nees_independent": errors.independent_count()}
    return {"channels": list(errors.channels), **_json_values(values | counts)}


def _json_values(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return values for JSON, with None in place of NaN and infinity."""
    return {name: float(value) if math.isfinite(value) else None for name, value in values.items()}
