"""Summary of a campaign as a page and as a table on the terminal."""

from collections.abc import Iterable, Sequence

from rich.table import Table

from ship_replay.report.page import render, versions
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


def page(results: Sequence[ItemResult]) -> str:
    """Return the campaign as a single HTML file; the same results give the same text."""
    in_order = sorted(results, key=lambda each: each[0].sort_key)
    items = [item for item, _ in in_order]
    return render(
        "campaign.html.j2",
        sections=SECTIONS,
        title="Campaign",
        items=items,
        failed=[(item, result["error"]) for item, result in in_order if result["error"] is not None],
        sources=_file_hashes({item.source for item in items}),
        parameter_sets=_file_hashes({item.parameters for item in items if item.parameters is not None}),
        seeds=_seeds_text(items),
        pools_by_parameters=pools_by_parameters(results),
        by_source=pools(results, lambda item: f"{item.source.name}, {item.parameters_name}"),
        worst=worst_items(in_order),
        code=items[0].code,
        skip_s=items[0].skip_s,
        versions=versions(),
    )


def pools_by_parameters(results: Sequence[ItemResult]) -> list[Pool]:
    """Return the results of each parameter set, pooled over all its items."""
    return pools(results, lambda item: item.parameters_name)


def pooled_table(pooled: Sequence[Pool]) -> Table:
    """Return the pooled errors as a table for the terminal."""
    table = Table(title="Errors against the truth over all items, arcseconds")
    for column in ("parameters", "source", "angle"):
        table.add_column(column)
    for column in ("RMS", "predicted σ", "RMS/σ", "NEES", "99.9 % band", "items"):
        table.add_column(column, justify="right")
    for pool in pooled:
        for errors in pool.errors:
            for place, channel in enumerate(errors.channels):
                first = place == 0
                band = f"{number(errors.band[0])} to {number(errors.band[1])}"
                table.add_row(
                    pool.name if first and errors is pool.errors[0] else "",
                    errors.label if first else "",
                    channel.name,
                    *(number(value) for value in (channel.rms_arcsec, channel.sigma_arcsec, channel.ratio)),
                    *((number(errors.fit.mean), band, str(errors.items)) if first else ("", "", "")),
                    end_section=place + 1 == len(errors.channels),
                )
    return table


def _file_hashes(files: Iterable[InputFile]) -> list[tuple[str, str]]:
    return sorted((file.name, file.sha256) for file in files)


def _seeds_text(items: Sequence[Item]) -> str:
    seeds = sorted({item.seed for item in items if item.seed is not None})
    if not seeds:
        return ""
    whole = seeds == list(range(seeds[0], seeds[-1] + 1))
    return f"{seeds[0]} to {seeds[-1]}" if whole and len(seeds) > 1 else ", ".join(map(str, seeds))
