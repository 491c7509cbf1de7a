"""The API document as a checker: does a value fit one of its schemas?"""

import functools
import json
from pathlib import Path

import jsonschema
import yaml

PROTO = Path(__file__).resolve().parents[2] / "proto"


@functools.lru_cache(maxsize=None)
def document():
    with open(PROTO / "openapi.yaml", encoding="utf-8") as file:
        return yaml.safe_load(file)


@functools.lru_cache(maxsize=None)
def validator(schema):
    resolver = jsonschema.RefResolver.from_schema(document())
    return jsonschema.Draft202012Validator(
        {"$ref": f"#/components/schemas/{schema}"}, resolver=resolver)


def check(schema, value):
    """Raises jsonschema.ValidationError where `value` does not fit."""
    validator(schema).validate(value)


def errors(schema, value):
    """What is wrong, as the API's field errors: [{pointer, detail}]."""
    return [{"pointer": "#/" + "/".join(map(str, error.absolute_path)),
             "detail": error.message[:255]} for error in validator(schema).iter_errors(value)]


def example(name):
    """A fresh copy of proto/examples/NAME.json."""
    return json.loads((PROTO / "examples" / f"{name}.json").read_text(encoding="utf-8"))
