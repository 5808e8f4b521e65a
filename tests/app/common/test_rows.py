"""Rows of reports: templates with digits and units, filled from the values of a report."""

from __future__ import annotations

import pytest

from palpate.app.common.rows import fill_template, named_rows, quantities, rows_of

REPORT = {
    "cloud": {"spacing": 0.00512, "nodes": 1200}, "share": 0.1234, "seconds": 3.2e-5, "none": None, "name": "x",
    "size": [0.01, 0.02],
}  # fmt: skip


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{cloud/spacing:.3g mm}", "5.12 mm"),
        ("{cloud/nodes} nodes", "1200 nodes"),
        ("{share:.1%}; {cloud/nodes:,}", "12.3%; 1,200"),
        ("{cloud/nodes:.2%}", "> 1000%"),
        ("{seconds: us}", "32 us"),
        ("{cloud/spacing: us}", "5,120 us"),
        ("{share:.2f N}", "0.12 N"),
        ("{name}", "x"),
        ("{none:.2f mm}", "-"),
        ("{share:.1%} at {none:.0f ms}", "-"),
        ("{size:.1f mm}", "10.0 x 20.0 mm"),
        ("{size/1: mm}", "20 mm"),
    ],
)
def test_a_template_prints_values_in_its_digits_and_units(template, text):
    assert fill_template(template, REPORT) == text


@pytest.mark.parametrize("template", ["{cloud/volume:.2f}", "{share/volume}"])
def test_a_template_without_its_values_raises(template):
    with pytest.raises(KeyError):
        fill_template(template, REPORT)


def test_names_of_a_person_are_not_templates():
    forces = {"left: {back}/1": 2.0}
    rows = named_rows("force of {!r}", "forces", "{value:.1f N}", forces)
    assert rows_of(rows, {"forces": forces}) == {"force of 'left: {back}/1'": ["2.0 N"]}


def test_a_row_is_left_out_where_no_entry_has_its_values():
    rows = {
        "nodes": "{nodes}",
        "time": "{seconds:.1f s}",
        "far": "{far}",
        "twice": lambda values: f"{2 * values['nodes']}",
    }
    entries = ({"nodes": 3}, {"nodes": 4, "seconds": 0.5})
    assert rows_of(rows, *entries) == {"nodes": ["3", "4"], "time": ["-", "0.5 s"], "twice": ["6", "8"]}


def test_a_table_has_a_column_for_every_entry():
    table = quantities("Title", {"nodes": "{nodes}"}, {"full": {"nodes": 3}, "reduced": {"nodes": 4}})
    assert (table.title, table.columns) == ("Title", ("quantity", "full", "reduced"))
    assert list(table.rows) == [("nodes", "3", "4")]
