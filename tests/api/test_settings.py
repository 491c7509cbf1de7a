"""The contract says of every setting what the tables of common/settings say, and names the effects,
lenses and formats of paths that there are.

`python3 tests/api/test_settings.py --write` brings proto/openapi.yaml and camera.schema.json up to
date.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
OPENAPI = ROOT / "proto" / "openapi.yaml"
CAMERA = ROOT / "proto" / "camera.schema.json"
BUILD = Path(os.environ.get("RIPNERF_BUILD", ROOT / "build"))
KINDS = {"bool": "boolean", "int": "integer", "number": "number", "choice": "string",
         "colour": "array", "text": "string"}
COMPARED = ("type", "enum", "minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum")
# Schema -> the table, and whether its rows are asked for, by option or by name, or told of a scene.
SCHEMAS = {"FieldConfig": ("train", False), "TrainOptions": ("train", True),
           "TrainSettings": ("train", "by name"),
           "RenderRequest": ("render", True), "PathOptions": ("render", True),
           "EvalOptions": ("render", True), "CurveSetting": ("render", True),
           "Optics": ("optics", True)}
# What these have beside settings.
OTHERS = {"FieldConfig": {"finest_cone"},
          "TrainOptions": {"preset", "threads", "ranks", "device", "kernels", "checkpoint_interval_s",
                           "evaluate_interval_s", "settings"},
          "TrainSettings": set(),
          "RenderRequest": {"camera", "view", "lens", "colours", "at", "scale", "size", "output", "background", "crop", "format",
                            "jpeg_quality", "optics"},
          "PathOptions": {"width", "height", "first", "last", "output", "fps", "film",
                          "video_quality", "format", "jpeg_quality", "crop", "optics"},
          "EvalOptions": {"split", "views", "scale", "at"}, "CurveSetting": set(), "Optics": set()}
NAMES = {"EffectName": "effects", "PathFormat": "path_formats"}  # schema -> the names that it lists


def told():
    answer = subprocess.run([BUILD / "tests" / "support" / "settings"], capture_output=True,
                            text=True, check=True)
    return json.loads(answer.stdout)


def tables():
    return {name: table for name, table in told().items() if name in ("train", "render", "optics")}


def rows(tables, schema):
    """The table's rows as they are named there: {name: row}."""
    table, asked = SCHEMAS[schema]
    if asked == "by name":
        return {row["name"]: row for row in tables[table] if row["by_name"]}
    return {row["option"] if asked else row["told"]: row for row in tables[table]
            if row["option"] or not asked}


def schema_of(row, asked):
    """What the contract has to say of a row; numbers as a record may also be 0."""
    flags, low, high = row["flags"], row["min"], row["max"]
    if row["type"] == "text":
        return {"type": "string"}
    if row["choices"]:
        return {"type": "string", "enum": row["choices"]}
    if row["type"] in ("bool", "colour"):
        return {"type": KINDS[row["type"]]}
    def whole(value):
        return int(value) if value == int(value) else value

    or_zero = flags["or_zero"] and asked is not True
    if flags["power_of_two"]:
        count = int(high / low).bit_length()
        values = [whole(low * 2 ** i) for i in range(count)]
        return {"type": KINDS[row["type"]], "enum": [0] * or_zero + values}
    over = flags["over_min"] and not or_zero
    return {"type": KINDS[row["type"]],
            "exclusiveMinimum" if over else "minimum": whole(0 if or_zero else low),
            "exclusiveMaximum" if flags["under_max"] else "maximum": whole(high)}


def description_of(row):
    unit = "" if row["unit"] in row["meaning"] else f" ({row['unit']})"
    return row["meaning"][0].upper() + row["meaning"][1:] + unit


def resolved(document, node):
    if "$ref" not in node:
        return node
    target = document
    for key in node["$ref"].removeprefix("#/").split("/"):
        target = target[key]
    return {**target, **{key: value for key, value in node.items() if key != "$ref"}}


def lens_schemas():
    """What the contract has to say of a lens: {property: schema}."""
    lenses, parameters = told()["lenses"], {}
    for own in lenses.values():
        for name, most in own.items():
            parameters[name] = max(most, parameters.get(name, 0))
    return {"model": {"type": "string", "enum": list(lenses)},
            **{name: {"type": "number", "minimum": -most, "maximum": most}
               for name, most in parameters.items()}}


@pytest.fixture(scope="module", name="document")
def fixture_document():
    return yaml.safe_load(OPENAPI.read_text(encoding="utf-8"))


@pytest.fixture(scope="module", name="built")
def fixture_built():
    return tables()


@pytest.mark.parametrize("schema", SCHEMAS)
def test_contract_has_the_settings(document, built, schema):
    written = document["components"]["schemas"][schema]
    expected = rows(built, schema)
    assert set(written["properties"]) == set(expected) | OTHERS[schema], \
        "tests/api/test_settings.py --write adds what is missing"
    for name, row in expected.items():
        node = resolved(document, written["properties"][name])
        assert {key: node[key] for key in COMPARED if key in node} == \
            schema_of(row, SCHEMAS[schema][1]), f"{schema}.{name}"
        if "$ref" not in written["properties"][name]:  # which may say more
            assert node["description"] == description_of(row), f"{schema}.{name}"
    if schema == "FieldConfig":
        older = {name for name, row in expected.items() if row["flags"]["later"]}
        assert set(written["required"]) == (set(expected) | {"finest_cone"}) - older


def test_contract_and_client_have_the_names(document):
    have, schemas = told(), document["components"]["schemas"]
    for schema, names in NAMES.items():
        assert schemas[schema]["enum"] == have[names], "tests/api/test_settings.py --write"
    assert schemas["Lens"]["properties"] == lens_schemas(), "tests/api/test_settings.py --write"
    usage = subprocess.run([BUILD / "client" / "ripnerf", "paths", "--help"], capture_output=True,
                           text=True, check=True).stdout
    assert ", ".join(have["path_formats"]) in " ".join(usage.split())


@pytest.mark.parametrize("name", ["Scene.json", "SceneList.json"])
def test_examples_tell_every_setting(built, name):
    example = json.loads((ROOT / "proto" / "examples" / name).read_text(encoding="utf-8"))
    for scene in example.get("items", [example]):
        if scene["config"]:
            all_of_them = rows(built, "FieldConfig")
            older = {key for key, row in all_of_them.items() if row["flags"]["later"]}
            assert set(scene["config"]) - older == set(all_of_them) - older | {"finest_cone"}
            assert set(scene["config"]) & older <= set(all_of_them)


def test_presets_end_where_it_is_told(built):
    """README, the guide, the client's help and the page's form say when a preset ends."""
    rows_by_name = {row["name"]: row["presets"] for row in built["train"]}
    seconds, steps = rows_by_name["max_seconds"], rows_by_name["max_steps"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    guide = (ROOT / "web/guide/index.html").read_text(encoding="utf-8")
    page = (ROOT / "web/js/views/train.js").read_text(encoding="utf-8")
    usage = subprocess.run([BUILD / "client" / "ripnerf", "train", "--help"], capture_output=True,
                           text=True, check=True).stdout
    for i, name in enumerate(("paper", "standard", "draft")):
        end = f"{seconds[i]:g} s" if seconds[i] else f"{steps[i]:,.0f} steps"
        assert re.search(rf"^\| `{name}` \|.*\| {end} \|$", readme, re.MULTILINE), name
        assert re.search(rf"<td><code>{name}</code></td>.*<td>{end}</td>", guide), name
        assert f"{name} after {end}" in " ".join(usage.split()), name
        given = f"{seconds[i]:g}" if seconds[i] else ""
        assert re.search(rf"^  {name}: {{.*seconds: '{given}'}}", page, re.MULTILINE), name


def test_rows_are_complete(built):
    for table in built.values():
        names = [row["name"] for row in table]
        assert len(names) == len(set(names))
        for row in table:
            assert row["meaning"] and len(row["meaning"]) < 160 and row["unit"] is not None
            assert bool(row["flag"]) == bool(row["option"])
            assert row["type"] not in ("int", "number", "colour") or row["min"] < row["max"]


def test_help_explains_every_flag(built):
    for verb, table in (("train", "train"), ("render", "render"), ("path", "render"),
                        ("eval", "render"), ("render", "optics"), ("path", "optics")):
        usage = subprocess.run([BUILD / "client" / "ripnerf", verb, "--help"],
                               capture_output=True, text=True, check=True).stdout
        words = " ".join(usage.split())  # lines are broken
        for row in built[table]:
            if row["flag"]:
                assert f"--{row['flag']} " in usage and row["meaning"] in words, verb


def line_of(name, node, indent=8):
    text = yaml.safe_dump(node, default_flow_style=True, width=10 ** 9, sort_keys=False)
    return f"{' ' * indent}{name}: {text.strip()}"


def mend(lines, begin, name, line):
    """Puts a property's line in the place of the one that it has, or behind the last."""
    at = begin
    while lines[at].startswith("        ") and not lines[at].startswith(f"        {name}: "):
        at += 1
    lines[at:at + lines[at].startswith("        ")] = [line]


def replace_block(lines, begin, block):
    """Puts lines in the place of those that stand at `begin` and are as deep as its first."""
    end = begin
    while lines[end].startswith("        "):
        end += 1
    lines[begin:end] = block


def write_lenses(lines):
    """All properties of a lens, in both documents."""
    schemas = lens_schemas()
    replace_block(lines, lines.index("      properties:", lines.index("    Lens:")) + 1,
                  [line_of(name, schema) for name, schema in schemas.items()])
    alone = CAMERA.read_text(encoding="utf-8").split("\n")
    begin = next(i for i, line in enumerate(alone) if line.startswith('        "model": '))
    rows = [f'        "{name}": {json.dumps(schema)}' for name, schema in schemas.items()]
    replace_block(alone, begin, ",\n".join(rows).split("\n"))
    CAMERA.write_text("\n".join(alone), encoding="utf-8")


def write():
    """Mends the lines of properties and names that say something else, and adds what is missing."""
    built, document = tables(), yaml.safe_load(OPENAPI.read_text(encoding="utf-8"))
    lines = OPENAPI.read_text(encoding="utf-8").split("\n")
    for schema, (_, asked) in SCHEMAS.items():
        have = document["components"]["schemas"][schema]["properties"]
        begin = lines.index("      properties:", lines.index(f"    {schema}:")) + 1
        for name, row in rows(built, schema).items():
            node = have.get(name, {})
            said = resolved(document, node)
            wanted = schema_of(row, asked)
            same = {key: said[key] for key in COMPARED if key in said} == wanted
            if same and ("$ref" in node or node.get("description") == description_of(row)):
                continue
            kept = {key: value for key, value in node.items()
                    if key not in (*COMPARED, "$ref", "description")}
            line = line_of(name, {**wanted, **kept, "description": description_of(row)})
            mend(lines, begin, name, line)
    write_lenses(lines)
    for schema, names in NAMES.items():
        node = {**document["components"]["schemas"][schema], "enum": told()[names]}
        at = next(i for i, line in enumerate(lines) if line.startswith(f"    {schema}: {{"))
        lines[at] = line_of(schema, node, 4)
    OPENAPI.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    write()
