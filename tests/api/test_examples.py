"""The examples of the contract are valid, and the document itself is consistent."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

PROTO = Path(__file__).resolve().parents[2] / "proto"
EXAMPLES = sorted(PROTO.glob("examples/*.json"))


@pytest.fixture(scope="module")
def document():
    return yaml.safe_load((PROTO / "openapi.yaml").read_text(encoding="utf-8"))


def references(node):
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"]
        for value in node.values():
            yield from references(value)
    elif isinstance(node, list):
        for value in node:
            yield from references(value)


def test_schemas_are_schemas(document):
    jsonschema.Draft202012Validator.check_schema({"$defs": document["components"]["schemas"]})


def test_references_resolve(document):
    for reference in set(references(document)):
        node = document
        for key in reference.removeprefix("#/").split("/"):
            node = node[key]


def test_operations_are_named_once(document):
    names = [operation["operationId"] for path in document["paths"].values()
             for method, operation in path.items() if method in ("get", "post", "delete", "patch")]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_is_valid(document, path):
    schema = {"$ref": "#/components/schemas/" + path.name.split(".")[0],
              "components": document["components"]}
    jsonschema.Draft202012Validator(schema).validate(json.loads(path.read_text(encoding="utf-8")))


def expanded(node, document):
    """A schema with its references put in and its descriptions left out."""
    if isinstance(node, list):
        return [expanded(value, document) for value in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        name, pointer = node["$ref"].split("#")
        if name:
            document = json.loads((PROTO / name).read_text(encoding="utf-8"))
        target = document
        for key in pointer.removeprefix("/").split("/"):
            target = target[key]
        return expanded(target, document)
    dropped = {"description", "title", "$schema", "$id", "$defs"}
    kept = {key: expanded(value, document) for key, value in node.items()
            if key not in dropped}
    return {key: value for key, value in kept.items()
            if not (key == "type" and "enum" in kept)}


@pytest.mark.parametrize("file, schema", [("camera.schema.json", "CameraFile"),
                                          ("path.schema.json", "PathFile")])
def test_file_schemas_are_those_of_the_document(document, file, schema):
    alone = json.loads((PROTO / file).read_text(encoding="utf-8"))
    shared = document["components"]["schemas"][schema]
    assert expanded(alone, alone) == expanded(shared, document)


def test_problems_are_listed():
    table = (PROTO / "problems.md").read_text(encoding="utf-8")
    source = (PROTO / "problem.c").read_text(encoding="utf-8")
    listed = {line.split("`")[1]: int(line.split("|")[2]) for line in table.splitlines()
              if line.startswith("| `")}
    used = {}
    for line in source.splitlines():
        if line.strip().startswith("[RN_PROBLEM_") and '{"' in line:
            fields = line.split('"')
            used[fields[1]] = int(fields[-1].strip(" ,};"))
    assert used == listed
