"""Summary of a campaign as a page and as a table on the terminal, from statistics pooled over many results.

The statistics are the errors, sigmas and statuses of each parameter set, and the worst items.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, repeat
from pathlib import Path
from typing import Any

from rich.table import Table

from ship_node.pages.console_tables import console_table
from ship_node.pages.html_page import render
from ship_replay.report.consistency import SigmaFit, mean_nees_fit, nees_band
from ship_replay.report.page import versions
from ship_replay.report.tables import number
from ship_studies.campaign.items import InputFile, Item, ItemResult

MAX_WORST_ITEMS = 10

SECTIONS = (
    ("made", "Items"),
    ("errors", "Errors by parameter set"),
    ("statuses", "Statuses and rejections"),
    ("sources", "Errors by bag or scenario"),
    ("worst", "Worst items"),
    ("failed", "Failed items"),
    ("provenance", "Hashes and versions"),
)
"""Ids and titles of the sections, in order."""

_STATUSES = ("VALID", "COASTING", "DEGRADED", "INVALID")


@dataclass(frozen=True)
class PooledChannel:
    """Statistics of one channel of one source, over all samples of several items.

    Attributes:
        name: name of the channel.
        rms_arcsec: root mean square of the errors.
        sigma_arcsec: root of the mean predicted variance; NaN if an item has no predicted variance.
    """

    name: str
    rms_arcsec: float
    sigma_arcsec: float

    @property
    def ratio(self) -> float:
        """RMS of the errors divided by sigma."""
        return self.rms_arcsec / self.sigma_arcsec


@dataclass(frozen=True)
class PooledErrors:
    """Statistics of the errors of one source over several items.

    Attributes:
        label: label as in an evaluation: ``fused``, ``ins``, ``star.<id>``, ``pointing``.
        items: number of items with this source.
        samples: total number of samples.
        channels: statistics of the source's three channels.
        fit: result of the consistency test of the mean NEES.
        band: 99.9 % band of the mean NEES.
    """

    label: str
    items: int
    samples: int
    channels: list[PooledChannel]
    fit: SigmaFit
    band: tuple[float, float]


@dataclass(frozen=True)
class Pool:
    """Common statistics of several items.

    Attributes:
        name: name that the items share.
        items: number of completed items.
        failed: number of failed items.
        errors: statistics of the errors of each source, in the order of the items.
        shares: topic → status → share of the topic's outputs with this status.
        refused: number of messages that were not used.
    """

    name: str
    items: int
    failed: int
    errors: list[PooledErrors]
    shares: dict[str, dict[str, float]]
    refused: int


def pools(results: Sequence[ItemResult], name: Callable[[Item], str]) -> list[Pool]:
    """Return one pool for each name, with all items of this name, sorted by name."""
    by_name = sorted(results, key=lambda each: (name(each[0]), each[0].sort_key))
    return [_pool(shared, list(group)) for shared, group in groupby(by_name, key=lambda each: name(each[0]))]


def worst_items(results: Sequence[ItemResult]) -> list[tuple[Item, str, str, float, float, float]]:
    """Return up to ten items with the largest ratios of RMS error to predicted sigma, the worst first.

    Each item has label and name of its worst channel, and this channel's RMS error and sigma, arcsec, and their ratio.
    """
    worst = []
    for item, result in results:
        ratios = [
            (values[f"{channel}.rms_over_sigma"], label, channel)
            for label, values in result["errors"].items()
            for channel in values["channels"]
            if values[f"{channel}.rms_over_sigma"] is not None
        ]
        if ratios:
            ratio, label, channel = max(ratios)
            values = result["errors"][label]
            sizes_arcsec = values[f"{channel}.rms_arcsec"], values[f"{channel}.sigma_arcsec"]
            worst.append((item, label, channel, *sizes_arcsec, ratio))
    return sorted(worst, key=lambda each: (-each[-1], each[0].sort_key))[:MAX_WORST_ITEMS]


def _pool(name: str, item_results: list[ItemResult]) -> Pool:
    results = [result for _, result in item_results if result["error"] is None]
    labels = dict.fromkeys(label for result in results for label in result["errors"])
    counts: dict[str, Counter[str]] = {}
    for result in results:
        for topic, statuses in result["statuses"].items():
            counts.setdefault(topic, Counter()).update(statuses)
    return Pool(
        name=name,
        items=len(results),
        failed=len(item_results) - len(results),
        errors=[
            _pooled_errors(label, [result["errors"][label] for result in results if label in result["errors"]])
            for label in labels
        ],
        shares={
            topic: {word: count / statuses_of_topic.total() for word, count in statuses_of_topic.items()}
            for topic, statuses_of_topic in counts.items()
        },
        refused=sum(sum(reasons.values()) for result in results for reasons in result["refused"].values()),
    )


def _pooled_errors(label: str, parts: list[dict[str, Any]]) -> PooledErrors:
    samples = [part["samples"] for part in parts]
    channels = [
        PooledChannel(
            channel,
            _root_mean_square((part[f"{channel}.rms_arcsec"] for part in parts), samples),
            _root_mean_square((part[f"{channel}.sigma_arcsec"] for part in parts), samples),
        )
        for channel in parts[0]["channels"]
    ]
    # Errors are correlated within a run: the weight of a run is its equivalent number of independent errors.
    with_nees = [part for part in parts if part["nees_mean"] is not None]
    independent = math.fsum(part["nees_independent"] for part in with_nees)
    mean = (
        math.fsum(part["nees_mean"] * part["nees_independent"] for part in with_nees) / independent
        if with_nees
        else math.nan
    )
    count = round(math.fsum(part["nees_count"] for part in with_nees))
    fit = mean_nees_fit(label, mean, count, independent)
    return PooledErrors(label, len(parts), round(math.fsum(samples)), channels, fit, nees_band(independent))


def _root_mean_square(values: Iterable[float | None], weights: Sequence[float]) -> float:
    """Return the root of the weighted mean square; NaN if a value is missing."""
    squares = [math.nan if value is None else weight * value**2 for value, weight in zip(values, weights, strict=True)]
    return math.sqrt(sum(squares) / math.fsum(weights))


def page(results: Sequence[ItemResult]) -> str:
    """Return the campaign as a single HTML file; the same results give the same text."""
    in_order = sorted(results, key=lambda each: each[0].sort_key)
    items = [item for item, _ in in_order]
    by_parameters = pools_by_parameters(results)
    by_source = pools(results, lambda item: f"{item.source.name}, {item.parameters_name}")
    return render(
        Path(__file__).with_name("page.html.j2"),
        sections=SECTIONS,
        title="Campaign",
        items=items,
        failed=[(item.name, result["error"]) for item, result in in_order if result["error"] is not None],
        sources=_file_hashes({item.source for item in items}),
        parameter_sets=_file_hashes({item.parameters for item in items if item.parameters is not None}),
        seeds=_seeds_text(items),
        pools_by_parameters=by_parameters,
        by_parameters=list(chain.from_iterable(_error_rows(by_parameters))),
        by_source=list(chain.from_iterable(_error_rows(by_source))),
        statuses=[
            [pool.name if first else "", topic, *(f"{100.0 * shares.get(word, 0.0):.1f} %" for word in _STATUSES),
             pool.refused if first else ""]
            for pool in by_parameters
            for first, (topic, shares) in zip(chain([True], repeat(False)), pool.shares.items(), strict=False)
        ],
        worst=[
            (item.name, label, channel, *map(number, numbers))
            for item, label, channel, *numbers in worst_items(in_order)
        ],
        code=items[0].code,
        skip_s=items[0].skip_s,
        versions=versions(),
    )


def pools_by_parameters(results: Sequence[ItemResult]) -> list[Pool]:
    """Return the results of each parameter set, pooled over all its items."""
    return pools(results, lambda item: item.parameters_name)


def pooled_table(pooled: Sequence[Pool]) -> Table:
    """Return the pooled errors as a table for the terminal."""
    columns = "parameters", "source", "angle", ">RMS", ">predicted σ", ">RMS/σ", ">NEES", ">99.9 % band", ">items"
    groups = [[row[: len(columns)] for row in group] for group in _error_rows(pooled)]
    return console_table("Errors against the truth over all items, arcseconds", columns, groups)


def _error_rows(pooled: Sequence[Pool]) -> Iterator[list[list[str]]]:
    """Yield the rows of each source; values of the pool and of the source are in their first rows only."""
    for pool in pooled:
        for errors in pool.errors:
            fit, band = errors.fit, f"{number(errors.band[0])} to {number(errors.band[1])}"
            of_source = [number(fit.mean), band, str(errors.items), number(fit.independent), fit.words]
            yield [
                [
                    pool.name if channel is pool.errors[0].channels[0] else "",
                    errors.label if channel is errors.channels[0] else "",
                    channel.name,
                    *map(number, (channel.rms_arcsec, channel.sigma_arcsec, channel.ratio)),
                    *(of_source if channel is errors.channels[0] else [""] * len(of_source)),
                ]
                for channel in errors.channels
            ]


def _file_hashes(files: Iterable[InputFile]) -> list[tuple[str, str]]:
    return sorted((file.name, file.sha256) for file in files)


def _seeds_text(items: Sequence[Item]) -> str:
    seeds = sorted({item.seed for item in items if item.seed is not None})
    if not seeds:
        return ""
    whole = seeds == list(range(seeds[0], seeds[-1] + 1))
    return f"{seeds[0]} to {seeds[-1]}" if whole and len(seeds) > 1 else ", ".join(map(str, seeds))
