"""The mutations of the sources still find the text that they change."""

from __future__ import annotations

from pathlib import Path

from mutations import MUTATIONS, Mutation, faults


def test_every_mutation_changes_one_place():
    assert not faults(MUTATIONS)
    assert len(MUTATIONS) >= 20
    assert len({each.name for each in MUTATIONS}) == len(MUTATIONS)
    assert all(each.old != each.new for each in MUTATIONS)


def test_a_text_that_is_not_there_or_there_twice_is_a_fault():
    for old in ("no such text", "def "):
        assert "it must occur once" in faults([Mutation("none", "tissue/materials.py", old, "", ())])[0]


def test_the_tests_of_every_mutation_exist():
    root = Path(__file__).parents[2]
    for each in MUTATIONS:
        for test in each.tests:
            file, _, name = test.partition("::")
            assert (root / file).exists(), each.name
            assert f"def {name.partition('[')[0]}(" in (root / file).read_text() or not name, test
