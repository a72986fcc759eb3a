"""Summary of a campaign as a page and as a table on the terminal."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path

from rich.table import Table

from ship_node.pages.console_tables import console_table
from ship_node.pages.html_page import render
from ship_replay.report.page import versions
from ship_replay.report.wording import number
from ship_studies.campaign.items import InputFile, Item
from ship_studies.campaign.pooled import Pool, pools, worst_items
from ship_studies.campaign.results import ItemResult

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
            (each.item.name, each.label, each.channel, *map(number, (each.rms_arcsec, each.sigma_arcsec, each.ratio)))
            for each in worst_items(in_order)
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
