"""Rows of reports: templates with digits and units, filled from the values of a report."""

from __future__ import annotations

import pytest

from palpate.app.common.rows import fill_template, quantities, rows_of

REPORT = {"cloud": {"spacing": 0.00512, "nodes": 1200}, "share": 0.1234, "seconds": 3.2e-5, "none": None, "name": "x"}


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
        ("{cloud/volume:.2f}", None),
        ("{share/volume}", None),
    ],
)
def test_a_template_prints_values_in_its_digits_and_units(template, text):
    assert fill_template(template, REPORT) == text


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
