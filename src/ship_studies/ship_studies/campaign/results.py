"""Folder of a campaign: one file for each result, named by the key of its item, and one table of all results."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.output_files import check_folder, csv_text, write_atomically
from ship_studies.campaign.items import Item
from ship_studies.campaign.one_item import Result

TABLE, PAGE = "table.csv", "campaign.html"

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
