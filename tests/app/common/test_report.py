"""Reports: one function writes every study's, as JSON and as Markdown, and prints it."""

from __future__ import annotations

import json

import pytest

from palpate.app.check import command as check
from palpate.app.common.console import Table, quantities_table
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.fit import command as fit
from palpate.app.run import command as run
from palpate.app.run import realtime
from palpate.app.studies.reproduce import PAPER_EXAMPLES
from palpate.app.train import report as train

FILES = [module.FILES for module in (check, fit, run, realtime, train)]
FILES += [example.files for example in PAPER_EXAMPLES.values()]


@pytest.fixture
def delivered(tmp_path, capsys):
    (tmp_path / "a_curve.png").write_bytes(b"")
    report = {"title": "Study", "machine": machine(), "figure": 1.5}
    blocks = [
        quantities_table("Study", ["here"], {"a | b": ["1"]}), "It holds.", "It ends.",
        Table("More", ("k",), [["2"]], ["left"]),
    ]  # fmt: skip
    deliver(report, blocks, tmp_path, [*REPORTS, "a_curve.png", "missing.png"], as_json=False)
    return tmp_path, report, capsys.readouterr().out


def test_the_json_report_equals_the_report(delivered):
    out, report, _ = delivered
    assert json.loads((out / "report.json").read_text()) == report


def test_the_markdown_report_has_tables_sentences_and_pictures(delivered):
    text = (delivered[0] / "report.md").read_text()
    expected = (
        "# Study\n\n| quantity | here |\n|---|---:|\n| a \\| b | 1 |\n\n- It holds.\n- It ends.\n\n## More\n\n"
        "| k |\n|---|\n| 2 |\n\n![a curve](a_curve.png)\n\n"
    )
    assert text.startswith(expected)
    assert f"palpate {machine()['versions']['palpate']}" in text


def test_printed_output_ends_with_the_written_files(delivered):
    out, _, printed = delivered
    assert "It holds." in printed
    assert printed.splitlines()[-1] == f"In {out}: report.json, report.md, a_curve.png"


@pytest.mark.parametrize("files", FILES, ids=" ".join)
def test_every_study_writes_both_reports(files):
    assert set(REPORTS) <= set(files)
