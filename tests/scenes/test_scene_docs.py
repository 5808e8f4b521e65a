"""Every key of scene files stands in docs/reference/scene_files.md and in the schema, with its unit."""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import is_dataclass
from pathlib import Path

import pytest

from palpate.core.parameters import fields_of
from palpate.scenes import description as sections
from palpate.scenes.names import PACKAGE_SCENES
from palpate.scenes.schema import scene_schema

pytestmark = pytest.mark.lint

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))
key_tables = __import__("key_tables")
DATA = Path(sections.__file__).parent / "data"


def test_the_documentation_has_a_table_of_every_section():
    text = key_tables.PAGE.read_text(encoding="utf-8")
    assert [match[1] for match in key_tables.TABLE.finditer(text)] == list(key_tables.HEADS)
    kinds = {kind for kind in vars(sections).values() if is_dataclass(kind) and kind.__module__ == sections.__name__}
    assert set(key_tables.HEADS.values()) == kinds - {sections.Description}


def test_the_documentation_has_every_key_with_its_unit_default_and_meaning():
    text = key_tables.PAGE.read_text(encoding="utf-8")
    assert key_tables.rewritten(text) == text, "stale tables; run: python docs/key_tables.py"


def test_the_schema_has_every_section_and_refuses_other_keys():
    schema = scene_schema()
    assert set(schema["properties"]) == set(fields_of(sections.Description))
    assert schema["required"] == ["surface"]
    place = schema["properties"]["support"]["items"]["properties"]["place"]
    assert set(place["properties"]) == set(fields_of(sections.Place))
    assert place["additionalProperties"] is False
    poisson = schema["properties"]["tissue"]["properties"]["poisson"]["anyOf"]
    assert poisson[0] == {"type": "number", "minimum": 0.0, "maximum": 0.5}
    assert json.loads(json.dumps(schema)) == schema


@pytest.mark.parametrize("name", PACKAGE_SCENES)
def test_scenes_of_the_package_have_keys_of_the_schema_only(name):
    def check(table, schema):
        if "properties" in schema:
            assert set(table) <= set(schema["properties"])
            for key, value in table.items():
                check(value, schema["properties"][key])
        elif schema.get("type") == "array" and "properties" in schema["items"]:
            for each in table:
                check(each, schema["items"])

    check(tomllib.loads((DATA / f"{name}.toml").read_text()), scene_schema())
