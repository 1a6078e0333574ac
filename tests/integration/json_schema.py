"""The part of JSON Schema (2020-12) that docs/reference/openapi.json uses. Standard library only."""

import math
import re

TYPES = {
    "object": lambda v: isinstance(v, dict),
    "array": lambda v: isinstance(v, list),
    "string": lambda v: isinstance(v, str),
    "boolean": lambda v: isinstance(v, bool),
    "null": lambda v: v is None,
    "number": lambda v: isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v),
    "integer": lambda v: TYPES["number"](v) and v == int(v),
}
# What says nothing of a value that is JSON.
NOTES = {"description", "examples", "default", "contentMediaType", "contentSchema"}
KEYWORDS = {
    "$ref", "type", "const", "enum", "oneOf", "anyOf", "properties", "required", "additionalProperties", "items",
    "minItems", "maxItems", "minLength", "maxLength", "pattern", "minimum", "maximum", "exclusiveMinimum",
    "exclusiveMaximum"} | NOTES


def equal(a, b):
    """As JSON counts it: true is not 1."""
    return type(a) is type(b) and a == b if isinstance(a, bool) or isinstance(b, bool) else a == b


class Schemas:
    """The schemas of a document.

    strict: a key that `properties` does not list is a fault even where the schema lets others be. So what a service
    answers is compared with all of its description.
    """

    def __init__(self, document, strict=False):
        self.document, self.strict = document, strict

    def at(self, reference):
        """The part of the document that '#/a/b' names."""
        if not reference.startswith("#/"):
            raise ValueError(f"{reference} is not in the document")
        part = self.document
        for step in reference[2:].split("/"):
            part = part[step.replace("~1", "/").replace("~0", "~")]
        return part

    def resolved(self, part):
        return self.at(part["$ref"]) if "$ref" in part else part

    def faults(self, value, schema, where="it"):
        """A line for each thing that is wrong; none where the value fits."""
        unknown = schema.keys() - KEYWORDS
        if unknown:
            raise ValueError(f"{where}: keywords that are not checked: {sorted(unknown)}")
        out = []
        if "$ref" in schema:
            out += self.faults(value, self.at(schema["$ref"]), where)
        types = schema.get("type", [])
        types = [types] if isinstance(types, str) else types
        if types and not any(TYPES[t](value) for t in types):
            return out + [f"{where}: {str(value)[:60]!r} is no {' or '.join(types)}"]
        if "const" in schema and not equal(value, schema["const"]):
            out.append(f"{where}: {value!r} is not {schema['const']!r}")
        if "enum" in schema and not any(equal(value, one) for one in schema["enum"]):
            out.append(f"{where}: {value!r} is none of {schema['enum']}")
        for several, is_right in (("oneOf", lambda n: n == 1), ("anyOf", lambda n: n > 0)):
            tried = [self.faults(value, one, where) for one in schema.get(several, [])]
            if tried and not is_right(sum(not lines for lines in tried)):
                out.append(f"{where}: {several}: {tried}")
        if isinstance(value, dict):
            out += self.faults_of_object(value, schema, where)
        elif isinstance(value, list):
            out += self.faults_of_array(value, schema, where)
        elif isinstance(value, str):
            out += faults_of_text(value, schema, where)
        elif TYPES["number"](value):
            out += faults_of_number(value, schema, where)
        return out

    def faults_of_object(self, value, schema, where):
        known = schema.get("properties", {})
        others = schema.get("additionalProperties", not (self.strict and known))
        out = [f"{where}: {key} is missing" for key in schema.get("required", []) if key not in value]
        for key, inner in value.items():
            if key in known:
                out += self.faults(inner, known[key], f"{where}.{key}")
            elif others is False:
                out.append(f"{where}: {key} is not known")
            elif others is not True:
                out += self.faults(inner, others, f"{where}.{key}")
        return out

    def faults_of_array(self, value, schema, where):
        out = []
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            out.append(f"{where}: {len(value)} items")
        for i, inner in enumerate(value):
            out += self.faults(inner, schema.get("items", {}), f"{where}[{i}]")
        return out


def faults_of_text(value, schema, where):
    out = []
    if not schema.get("minLength", 0) <= len(value) <= schema.get("maxLength", len(value)):
        out.append(f"{where}: {len(value)} characters")
    if "pattern" in schema and not re.search(schema["pattern"], value):
        out.append(f"{where}: {value[:60]!r} is not like {schema['pattern']}")
    return out


def faults_of_number(value, schema, where):
    wrong = (value < schema.get("minimum", value) or value > schema.get("maximum", value)
             or value <= schema.get("exclusiveMinimum", -math.inf)
             or value >= schema.get("exclusiveMaximum", math.inf))
    return [f"{where}: {value} is out of range"] if wrong else []
