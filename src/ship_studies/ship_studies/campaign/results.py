"""Result of an item: its computation, and the folder of all results of a campaign.

A scenario is simulated, the bag is replayed through the suite's nodes, and the outputs are evaluated against the truth.
The folder has one file for each result, named by the key of its item, and one table of all results.
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.output_files import check_folder, csv_text, write_atomically
from ship_bags.topic_names import TopicNames, topic_names
from ship_geometry.input_error import InputError
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.statistics import AttitudeErrors, json_values
from ship_replay.offline.digests import code_sha256
from ship_replay.offline.replay import ADAPTERS, replay
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

TABLE, PAGE = "table.csv", "campaign.html"


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
        "values": json_values(evaluation.quantities()),
        "statuses": {
            topic: dict(sorted(history.counts.items())) for topic, history in sorted(summary.status_histories.items())
        },
        "refused": {topic: dict(sorted(reasons.items())) for topic, reasons in sorted(summary.rejected.items())},
    }


def _statistics(errors: AttitudeErrors) -> dict[str, Any]:
    nees = errors.nees[np.isfinite(errors.nees)]
    values = errors.statistics() | {"nees_mean": float(np.mean(nees)) if len(nees) else math.nan}
    counts = {"nees_count": float(len(nees)), "nees_independent": errors.independent_count()}
    return {"channels": list(errors.channels), **json_values(values | counts)}


ItemResult = tuple[Item, Result]


class ResultFolder:
    """Results stored on the disk.

    Args:
        folder: folder of the campaign, created if it does not exist.

    Raises:
        BadInput: the folder cannot be created or written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        check_folder(folder / "results", (), force=True)
        (folder / "results").mkdir(parents=True, exist_ok=True)

    def path(self, item: Item) -> Path:
        """Return the path of an item's result."""
        return self.folder / "results" / f"{item.key}.json"

    def result(self, item: Item) -> Result | None:
        """Return the stored result of an item; None if no result is stored.

        Raises:
            BadInput: the file is not a result.
        """
        path = self.path(item)
        try:
            found = json.loads(path.read_bytes())
            ingredients, result = found["item"], found["result"]
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as problem:
            raise BadInput("is not a result of a campaign: remove it", file=path) from problem
        if ingredients != item.key_fields:
            raise BadInput("is the result of another item: remove it", file=path)
        item_result: Result = result
        return item_result

    def save(self, item: Item, result: Result) -> None:
        """Write a result to the disk completely before returning.

        A failed result is not stored: a killed worker or a full disk may be a temporary problem.
        """
        if result["error"] is None:
            text = json.dumps({"item": item.key_fields, "result": result}, indent=1)
            write_atomically(self.path(item), text + "\n")


def csv_table(results: Sequence[ItemResult]) -> str:
    """Return all results as CSV, one line for each item, in the order of the items.

    The columns after the item and its error are the quantities of ``evaluate --json``, the number of outputs by status
    (``status.<topic>.<status>``) and the number of messages that were not used by reason
    (``refused.<topic>.<reason>``).
    """
    in_order = sorted(results, key=lambda each: each[0].sort_key)
    rows = [_flat(result) for _, result in in_order]
    columns = list(dict.fromkeys(name for values in rows for name in values))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["source", "parameters", "seed", "error", *map(csv_text, columns)])
    for (item, result), values in zip(in_order, rows, strict=True):
        texts = (csv_text(text) for text in (item.source.name, item.parameters_name))
        head = [*texts, item.seed, csv_text(result["error"] or "")]
        writer.writerow([*head, *(values.get(name) for name in columns)])
    return text.getvalue()


def _flat(result: Result) -> dict[str, Any]:
    values: dict[str, Any] = result["values"]
    return values | _with_dotted_names("status", result["statuses"]) | _with_dotted_names("refused", result["refused"])


def _with_dotted_names(head: str, counts: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    return {f"{head}.{topic}.{name}": count for topic, named in counts.items() for name, count in named.items()}
