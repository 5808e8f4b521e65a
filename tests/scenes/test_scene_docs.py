"""Every key of scene files stands in docs/scenes.md and in the schema, with its unit."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from palpate.parameters import fields_of
from palpate.scenes import description as sections
from palpate.scenes.names import PACKAGE_SCENES
from palpate.scenes.schema import scene_schema

DOCS = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
DATA = Path(sections.__file__).parent / "data"
HEADS = {
    sections.Shape: "[surface]", sections.Body: "[body]", sections.Tissue: "[tissue]",
    sections.Relaxation: "[tissue] relaxation = { ... }", sections.Fibre: "[tissue] fibres = { ... }",
    sections.Region: "[[region]]", sections.Support: "[[support]]", sections.Place: "place = { ... }",
    sections.Plane: "plane = { ... }", sections.Box: "box = { ... }", sections.Ball: "ball = { ... }",
    sections.Painted: "painted = { ... }", sections.Near: "near = { ... }", sections.Tool: "[tool]",
    sections.Cut: "[cut]", sections.Load: "[[load]]", sections.Run: "[run]", sections.Training: "[training]",
}  # fmt: skip


@pytest.mark.parametrize(("section", "head"), HEADS.items(), ids=HEADS.values())
def test_the_documentation_has_every_key_with_its_unit_and_meaning(section, head):
    part = DOCS.partition(f"### `{head}`\n")[2].partition("\n### ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in part.splitlines() if line.startswith("| `")
    ]
    documented = {row[0].strip("`"): (row[1], row[3].partition(": `")[0]) for row in rows}
    assert documented == {
        name: (field.metadata["unit"], field.metadata["help"]) for name, (field, _) in fields_of(section).items()
    }


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
