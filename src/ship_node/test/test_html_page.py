"""Frame and tables of the pages of studies and reports."""

from pathlib import Path

import pytest

from ship_node.pages.html_page import decimal_text, render

TEMPLATE = """{% extends "frame.html.j2" %}
{% from "parts.html.j2" import heading, table with context %}
{% block content %}{{ heading("b") }}{{ table(columns, rows, "None.", marked=rows[1:], remark="R") }}{% endblock %}
"""


def page(folder: Path, columns: list, rows: list) -> str:
    template = folder / "page.html.j2"
    template.write_text(TEMPLATE)
    return render(template, title="<t>", sections=(("a", "A"), ("b", "B")), columns=columns, rows=rows)


def test_frame_with_title_and_links_to_its_sections(tmp_path):
    text = page(tmp_path, ["x"], [])
    assert "<title>&lt;t&gt;</title>" in text
    assert '<a href="#a">A</a> <a href="#b">B</a>' in text
    assert '<h2 id="b">B</h2><p>None.</p>' in text
    assert "<table>" not in text


def test_table_of_rows_with_and_without_keys(tmp_path):
    text = page(tmp_path, ["name", ">size", "!when"], [["<i>", -0.001, ("12:00", "#m")], ["b", 2.0, ""]])
    assert '<th>name</th><th class="r">size</th><th class="w">when</th>' in text
    assert '<tr><td>&lt;i&gt;</td><td class="r">0.00</td><td class="w"><a href="#m">12:00</a></td></tr>' in text
    assert '<tr class="marked"><td>b</td><td class="r">2.00</td>' in text
    assert '<p class="note">R</p>' in text
    keyed = page(tmp_path, [("name", "n"), ("#hash", "h")], [{"h": "ff", "n": "a", "other": 1}])
    assert '<tr><td>a</td><td class="lines">ff</td></tr>' in keyed
    assert "<thead>" not in page(tmp_path, ["", "#"], [("a", "b")])


@pytest.mark.parametrize(("value", "text"), [(-1.236, "−1.24"), (-0.004, "0.00"), (float("nan"), "–")])
def test_decimal_text_has_a_minus_sign_and_a_dash(value, text):
    assert decimal_text(value) == text
