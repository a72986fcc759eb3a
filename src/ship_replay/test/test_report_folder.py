"""The page of a folder of bags: a row per session, differences to the previous one, errors of bad bags."""

import re
import shutil
from urllib.parse import unquote

from ship_bags.mcap.bag_writer import BagWriter
from ship_replay.commands.report import main
from ship_testing.hand_made_bags import PERIOD_NS, START_NS, imu
from ship_testing.report_bags import write_bag
from ship_testing.usage_errors import usage_error


def rows_of(text):
    """Return the cells of each row of the sessions, without tags; a difference follows its value."""
    body = text.partition("</thead>")[2].partition("</table>")[0]
    return [
        [re.sub(r"<[^>]+>", " ", cell).split() for cell in re.findall(r"<td[^>]*>(.*?)</td>", row)]
        for row in re.findall(r"<tr>(.*?)</tr>", body)
    ]


def test_a_row_for_each_session_with_the_difference_to_the_one_before(tmp_path, capsys):
    folder = tmp_path / "voyage"
    folder.mkdir()
    write_bag(folder / "a.mcap")
    # The hours are the same: this bag is later by name. It has no data for 5 s of 40 s, of which 1 s is within the
    # maximum age.
    write_bag(folder / "b 1.mcap", gap_s=(20, 25), rejected=range(30, 37))
    (folder / "bad.mcap").write_text("no bag")
    with BagWriter(folder / "inputs.mcap") as writer:
        writer.write("ins/imu", imu(START_NS), START_NS + PERIOD_NS)
    (folder / "notes.txt").write_text("no bag, and not called one")
    assert main([str(folder), "--out", str(tmp_path / "index.html")]) == 0
    out = capsys.readouterr().out
    assert "4 of 4: inputs.mcap: " in out
    text = (tmp_path / "index.html").read_text()
    first, second = rows_of(text)
    assert [row[0] for row in (first, second)] == [["a.mcap"], ["b", "1.mcap"]]
    header = re.findall(r"<th[^>]*>(.*?)</th>", text.partition("</thead>")[0])
    valid, worst, faults = (header.index(name) for name in ("ship/attitude VALID", "worst source", "faults"))
    assert first[valid][-1] == "%"  # no difference
    assert float(second[valid][0]) < 92.0
    assert second[valid][2].startswith("−")
    assert (first[worst], second[worst]) == (["none"], ["star.fore"])
    assert (first[faults], second[faults]) == (["0"], ["1", "+1"])
    failed = text.partition("Bags without a report")[2]
    assert "bad.mcap" in failed
    assert "no outputs of the suite" in failed
    links = [unquote(link) for link in re.findall(r'href="([^"]+)"', text)]
    assert links == ["index_reports/a.mcap.html", "index_reports/b 1.mcap.html"]
    for link in links:
        assert "<h2 id=\"verdict\">" in (tmp_path / link).read_text()


def test_nothing_is_written_over_without_force(tmp_path, capsys):
    folder = tmp_path / "voyage"
    folder.mkdir()
    write_bag(folder / "a.mcap", 5)
    command = [str(folder), "--out", str(tmp_path / "index.html")]
    assert main(command) == 0
    (tmp_path / "index.html").unlink()
    capsys.readouterr()
    assert "a.mcap.html" in usage_error(main, capsys, *command)
    assert main([*command, "--force"]) == 0


def test_truth_is_of_one_bag(tmp_path, capsys):
    folder = tmp_path / "voyage"
    folder.mkdir()
    path = write_bag(folder / "a.mcap", 5)
    assert "--truth is for one bag" in usage_error(main, capsys, folder, "--truth", path, "--out", tmp_path / "b.html")


def test_a_folder_without_bags_is_refused(tmp_path, capsys):
    folder = tmp_path / "empty"
    folder.mkdir()
    assert usage_error(main, capsys, folder, "--out", tmp_path / "b.html").startswith(f"report: {folder}: ")
    shutil.rmtree(folder)
