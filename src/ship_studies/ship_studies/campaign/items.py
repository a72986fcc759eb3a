"""Items of a campaign, each a bag or a scenario with a seed, under one parameter set; and their results.

A scenario is simulated, the bag is replayed through the suite's nodes, and the outputs are evaluated against the truth.
The folder of a campaign has one file for each result, named by the key of its item, and one table of all results.
"""

import csv
import hashlib
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.output_files import check_folder, csv_text, write_atomically
from ship_bags.provenance import code_sha256, content_sha256
from ship_bags.topic_names import TopicNames, topic_names
from ship_geometry.input_error import InputError
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.statistics import AttitudeErrors, json_values
from ship_replay.offline.adapter_chain import nodes_of
from ship_replay.offline.replay import ADAPTERS, replay
from ship_replay.offline.replay_summary import ReplaySummary
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

TABLE, PAGE = "table.csv", "campaign.html"

_SCENARIO_SUFFIXES = ".yaml", ".yml"
_KEY_LENGTH = 32
_SEEDS = re.compile(r"\d+(?:-\d+)?(?:,\d+(?:-\d+)?)*")


@dataclass(frozen=True)
class InputFile:
    """A file named on the command line.

    Attributes:
        name: path as typed.
        path: absolute path.
        contents: the file and the bag to which a scenario refers, each with absolute path and hash.
    """

    name: str
    path: Path
    contents: tuple[tuple[Path, str], ...]

    @property
    def sha256(self) -> str:
        """Hashes of the contents, one a line."""
        return "\n".join(digest for _, digest in self.contents)

    @property
    def is_scenario(self) -> bool:
        """True if the file of a source is a scenario to be simulated, False if it is a bag."""
        return self.path.suffix in _SCENARIO_SUFFIXES

    def check(self) -> None:
        """Check that the file is unchanged.

        Raises:
            BadInput: the file has changed.
            OSError: the file cannot be read.
        """
        if any(content_sha256(path) != digest for path, digest in self.contents):
            raise BadInput("has changed since the campaign began", file=self.name)


@dataclass(frozen=True)
class Item:
    """One run of a campaign.

    Attributes:
        source: bag or scenario.
        parameters: suite file; None for the suite file attached to the bag or made from the scenario.
        seed: seed of the simulation; None for a bag.
        skip_s: duration at the beginning of the bag that is excluded from the evaluation.
        namespace: namespace of the ship in the bag.
        remaps: topic remappings in the bag, see :class:`ship_bags.topic_names.TopicNames`.
        code: hash of the code that runs the item.
    """

    source: InputFile
    parameters: InputFile | None
    seed: int | None
    skip_s: float
    namespace: str
    remaps: tuple[tuple[str, str], ...]
    code: str

    @property
    def key_fields(self) -> dict[str, Any]:
        """Everything that the result depends on, with the hashes of files instead of their names."""
        return {
            "source_sha256": self.source.sha256,
            "parameters_sha256": None if self.parameters is None else self.parameters.sha256,
            "seed": self.seed,
            "skip_s": self.skip_s,
            "namespace": self.namespace,
            "remaps": [list(pair) for pair in self.remaps],
            "code_sha256": self.code,
        }

    @property
    def key(self) -> str:
        """Hash of the key fields, which names the file of the result."""
        return hashlib.sha256(json.dumps(self.key_fields).encode()).hexdigest()[:_KEY_LENGTH]

    @property
    def parameters_name(self) -> str:
        """Name of the parameter set for people."""
        return "as attached" if self.parameters is None else self.parameters.name

    @property
    def sort_key(self) -> tuple[str, str, int]:
        """Sort key in tables."""
        return self.source.name, self.parameters_name, -1 if self.seed is None else self.seed

    @property
    def name(self) -> str:
        """Name of the item for people."""
        seed = "" if self.seed is None else f", seed {self.seed}"
        return f"{self.source.name}, {self.parameters_name}{seed}"


def campaign_items(
    sources: Sequence[Path],
    parameter_sets: Sequence[Path],
    seeds: Sequence[int],
    skip_s: float = 0.0,
    namespace: str = "",
    remaps: Sequence[tuple[str, str]] = (),
) -> list[Item]:
    """Return the sorted items of a campaign: each source with each parameter set, a scenario also with each seed.

    Args:
        sources: scenarios (.yaml) and bags.
        parameter_sets: suite files; if empty, each source is run with its own suite file.
        seeds: seeds of the scenarios.
        skip_s: see :class:`Item`.
        namespace: namespace of the ship in the bags.
        remaps: topic remappings in the bags.

    Raises:
        BadInput: a scenario or suite file is invalid. Problems of a bag are reported by its run.
        OSError: a file cannot be read.
    """
    sources_with_hash = [_source(path) for path in dict.fromkeys(sources)]
    sets: list[InputFile | None] = [_parameter_set(path) for path in dict.fromkeys(parameter_sets)]
    code = code_sha256()
    items = [
        Item(source, parameters, seed, skip_s, *(("", ()) if source.is_scenario else (namespace, tuple(remaps))), code)
        for source in sources_with_hash
        for parameters in sets or [None]
        for seed in (dict.fromkeys(seeds) if source.is_scenario else (None,))
    ]
    return sorted(items, key=lambda item: item.sort_key)


def parse_seeds(text: str) -> list[int]:
    """Return the seeds in a text such as "1-200" or "1,5,7-9".

    Raises:
        ValueError: the text has another form.

    Example:
        >>> parse_seeds("1,5,7-9")
        [1, 5, 7, 8, 9]
    """
    if not _SEEDS.fullmatch(text):
        raise ValueError(f"'{text}' are not seeds such as 1-200 or 1,5,7-9")
    ranges = [[int(end) for end in part.split("-")] for part in text.split(",")]
    if any(ends[0] > ends[-1] for ends in ranges):
        raise ValueError(f"'{text}' contains a range that ends before it begins")
    return list(dict.fromkeys(seed for ends in ranges for seed in range(ends[0], ends[-1] + 1)))


def _source(path: Path) -> InputFile:
    source = _input_file(path)
    if not source.is_scenario:
        return source
    carrier = load_scenario(path).carrier
    return _input_file(path, Path(carrier.recording.bag)) if carrier.kind == "recorded" else source


def _parameter_set(path: Path) -> InputFile:
    nodes_of(path, ADAPTERS)
    return _input_file(path)


def _input_file(path: Path, *others: Path) -> InputFile:
    contents = tuple((each.resolve(), content_sha256(each)) for each in (path, *others))
    return InputFile(str(path), path.resolve(), contents)


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
