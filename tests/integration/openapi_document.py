"""docs/reference/openapi.json as tests read it: its operations, and bodies that it refuses. Standard library only."""

import itertools
import json
from dataclasses import dataclass
from pathlib import Path

from json_schema import Schemas

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "reference" / "openapi.json"
METHODS = ("get", "put", "post", "delete", "options", "head", "patch", "trace")


@dataclass
class Operation:
    """A method of a path."""
    path: str
    method: str  # in capitals
    what: dict   # the operation itself
    parameters: list

    def __str__(self):
        return f"{self.method} {self.path}"

    def address(self, **query):
        """The path with the examples of its parameters, and a query."""
        out = self.path
        for parameter in self.parameters:
            if parameter["in"] == "path":
                out = out.replace("{" + parameter["name"] + "}", str(parameter["example"]))
        return out + ("?" + "&".join(f"{k}={v}" for k, v in query.items()) if query else "")

    def queries(self):
        return [p for p in self.parameters if p["in"] == "query"]

    def body(self):
        """The description of the body's only form, or nothing."""
        return self.what.get("requestBody", {}).get("content", {}).get("application/json")


def read():
    return json.loads(FILE.read_text(encoding="utf-8"))


def operations(document):
    for path, item in document["paths"].items():
        for method in METHODS:
            if method in item:
                what = item[method]
                yield Operation(path, method.upper(), what, item.get("parameters", []) + what.get("parameters", []))


def examples_of(body, schemas):
    """Bodies that are written down as good ones."""
    named = [one["value"] for one in body.get("examples", {}).values()]
    own = [body["example"]] if "example" in body else []
    return named + own + schemas.resolved(body["schema"]).get("examples", [])


def candidates(schema, schemas):
    """Values of all types and around the limits of a schema."""
    schema = schemas.resolved(schema)
    out = ["text", "", "\x01", "../up", "a b.mkv", -7.5, True, None, [], {}, {"x": 1}, ["x"]]
    for limit in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
        if limit in schema:
            out += [schema[limit] - 1e-3, schema[limit], schema[limit] + 1e-3, 10 * schema[limit]]
    if "maxLength" in schema:
        out.append("x" * (schema["maxLength"] + 1))
    items = schema.get("items")
    if items:
        count = schema.get("minItems", 1)
        out += [[0] * (count - 1), [0] * (schema.get("maxItems", count) + 1)]
        out += [[value] + [0] * (count - 1) for value in candidates(items, schemas)]
    return out


def wrong_bodies(schema, good, schemas):
    """Bodies that the schema refuses, each wrong in one thing."""
    schema = schemas.resolved(schema)
    changed = [good | {"no_such_key": 1}]
    changed += [{k: v for k, v in good.items() if k != key} for key in schema.get("required", [])]
    for key, own in schema.get("properties", {}).items():
        changed += [good | {key: value} for value in candidates(own, schemas)]
    for body in itertools.chain(["text", 7.5, True, None, [], [good]], changed):
        if schemas.faults(body, schema):
            yield body


def all_references(part):
    if isinstance(part, dict):
        if isinstance(part.get("$ref"), str):
            yield part["$ref"]
        part = list(part.values())
    if isinstance(part, list):
        for inner in part:
            yield from all_references(inner)


def strict(document):
    """For what the service answers."""
    return Schemas(document, strict=True)
