"""Items of a campaign: each a bag or a scenario with a seed, under one parameter set."""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_replay.offline.adapter_chain import nodes_of
from ship_replay.offline.digests import code_sha256, content_sha256
from ship_replay.offline.replay import ADAPTERS
from ship_simulation.scenario.scenario_file import load_scenario

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
