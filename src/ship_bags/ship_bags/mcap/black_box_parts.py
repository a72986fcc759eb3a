"""Further files of a black box, which are next to the first file and are read with it."""

import re

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_file import open_mcap
from ship_bags.mcap.file_content import BagFile
from ship_bags.renamed_topics import BLACK_BOX_METADATA

_FIRST = "1"


def further_black_box_files(first: BagFile) -> list[BagFile]:
    """Return the files that continue the first file of a black box, in order; an empty list for any other file.

    A missing or unreadable file becomes a line in the problems of the first file.
    """
    entries = first.metadata.get(BLACK_BOX_METADATA, {})
    if entries.get("part") != _FIRST:
        return []
    found: dict[int, BagFile] = {}
    pattern = re.compile(re.escape(first.path.stem) + r"\.part\d+\.mcap", re.ASCII)
    for path in (path for path in first.path.parent.iterdir() if pattern.fullmatch(path.name)):
        try:
            file = open_mcap(path)
        except BadInput as problem:
            first.add_problem(str(problem))
            continue
        # Only the black-box header of the first file is kept.
        of_part = file.metadata.pop(BLACK_BOX_METADATA, {})
        number = of_part.get("part", "")
        if of_part.get("box") == entries.get("box") and number.isascii() and number.isdecimal():
            found[int(number)] = file
        else:
            file.close()
    for missing in set(range(2, max(found, default=1))) - found.keys():
        first.add_problem(f"{first.path.name}: part {missing} of the black box is missing")
    return [found[number] for number in sorted(found)]
